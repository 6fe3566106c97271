"""How far a splat moves, by the splats around it: the median of their displacements, or a linear field through them.

Arrays of neighbours are worked on as columns [k, m], neighbour by neighbour and axis by axis: numpy then goes through
whole rows, which takes a fifth of the time that small matrices do.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F64

Rows = NDArray[np.intp]

Flow: TypeAlias = Callable[[F64, F64, F64, Rows], F64]
"""How far splats [m, 3] move by those around them: see :func:`field_at`."""

TINY = 1e-12
"""Replaces a distance of zero: if splats coincide, everything elsewhere is out of reach."""

FIELD_ROUNDS, FIELD_RIDGE, FIELD_HOLDS = 3, 1e-3, 0.5
"""Rounds in which outliers lose their weight in a linear field, share of the weights that holds its slopes at zero
where points lie on a plane, and factor by which it has to reduce the distances from the median.
"""

FLOW_POINTS, FLOW_NEIGHBOURS = 8192, 4
"""Sample of moving splats, and number of nearest ones, from which a splat without a velocity takes the median."""

PIECE = 4096
"""Splats that are worked on at a time: their columns fit a processor's cache."""


def middle_at(places: F64, points: F64, moved: F64, near: Rows) -> F64:
    """As :func:`field_at`, the median alone."""
    del places, points
    axes = _axes(moved)
    return _in_pieces(near, lambda _, columns: np.stack([_middle(axis[columns]) for axis in axes], axis=1))


def field_at(places: F64, points: F64, moved: F64, near: Rows) -> F64:
    """How far splats at ``places`` [m, 3] move if they go with those of ``points`` [n, 3], which ``moved`` [n, 3], that
    are ``near`` [m, k] each: the value of a linear field, where one holds for them, otherwise the median.

    Points that agree with the others weigh more in the field.
    """
    of_points, of_moved, here = _axes(points), _axes(moved), _axes(places)

    def fitted(piece: slice, columns: Rows) -> F64:
        apart = [axis[columns] - own[piece] for axis, own in zip(of_points, here, strict=True)]
        return _field(apart, [axis[columns] for axis in of_moved])

    return _in_pieces(near, fitted)


def velocities_at(places: F64, points: F64, velocities: F64, *, others: bool = False) -> F64:
    """Velocities [m, 3] at ``places``: the medians of those of the nearest of ``points`` [n, 3].

    With ``others`` the places are the points, and each is told by the others alone.
    """
    from scipy.spatial import cKDTree

    stride = max(1, len(points) // FLOW_POINTS)
    points, velocities = points[::stride], velocities[::stride]
    k = min(FLOW_NEIGHBOURS + others, len(points))
    near = cKDTree(points).query(places, k=k, workers=1)[1].reshape(len(places), k)
    flow: F64 = np.median(velocities[near[:, others:]], axis=1)
    return flow


def _in_pieces(near: Rows, work: Callable[[slice, Rows], F64]) -> F64:
    """``work`` [m, 3] on all of ``near`` [m, k], piece by piece: it is given the piece, and its neighbours [k, m]."""
    pieces = [slice(first, first + PIECE) for first in range(0, len(near), PIECE)]
    done = [work(piece, np.ascontiguousarray(near[piece].T)) for piece in pieces]
    return np.concatenate([np.zeros((0, 3)), *done])


def _axes(values: F64) -> list[F64]:
    """The columns of ``values`` [n, 3], each in one piece."""
    return [np.ascontiguousarray(axis) for axis in values.T]


def _middle(columns: F64) -> F64:
    """The median [m] of each column of ``columns`` [k, m]. Sorting few rows is quicker than finding their middle."""
    ordered = np.sort(columns, axis=0)
    middle: F64 = (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2
    return middle


def _length(x: F64, y: F64, z: F64) -> F64:
    return np.sqrt(x * x + y * y + z * z)


def _field(apart: list[F64], values: list[F64]) -> F64:
    """The linear field through ``values`` at points that are ``apart`` from each place, both three times [k, m], at the
    places [m, 3]; or the median.
    """
    middle = [_middle(value) for value in values]
    unit = np.maximum(np.sqrt(sum(np.square(axis).mean(axis=0) for axis in apart)), TINY)
    axes = [axis / unit for axis in apart]
    before = off = _length(*(value - at for value, at in zip(values, middle, strict=True)))
    fits: list[tuple[F64, ...]] = []
    for _ in range(FIELD_ROUNDS):
        usual = np.maximum(2 * _middle(off), TINY)
        fits = _fitted(axes, values, 1 / (1 + np.square(off / usual)))
        off = _length(*(value - _value(fit, axes) for value, fit in zip(values, fits, strict=True)))
    holds = _middle(off) < FIELD_HOLDS * _middle(before)
    return np.stack([np.where(holds, fit[0], at) for fit, at in zip(fits, middle, strict=True)], axis=1)


def _value(fit: tuple[F64, ...], axes: list[F64]) -> F64:
    at, along_x, along_y, along_z = fit
    x, y, z = axes
    return at + x * along_x + y * along_y + z * along_z


def _fitted(axes: list[F64], values: list[F64], weights: F64) -> list[tuple[F64, ...]]:
    """Of each of ``values``, value at the origin and slopes [m] of the linear field that fits them best by least
    squares with ``weights``; all three times [k, m].

    The normal equations: the constant is eliminated first, the slopes by Cholesky's decomposition without roots.
    """
    total = weights.sum(axis=0)
    weighted = [axis * weights for axis in axes]
    mean = [axis.sum(axis=0) / total for axis in weighted]
    centred = [axis - at for axis, at in zip(axes, mean, strict=True)]
    held = FIELD_RIDGE * len(weights)
    xx, yy, zz = ((a * c).sum(axis=0) + held for a, c in zip(weighted, centred, strict=True))
    yx, zx, zy = ((weighted[i] * centred[j]).sum(axis=0) for i, j in ((1, 0), (2, 0), (2, 1)))
    below_y, below_z = yx / xx, zx / xx
    yy, zy = yy - below_y * yx, zy - below_z * yx
    beside = zy / yy
    zz = zz - below_z * zx - beside * zy
    fits: list[tuple[F64, ...]] = []
    for value in values:
        x, y, z = ((weights * axis * value).sum(axis=0) for axis in centred)
        y = y - below_y * x
        along_z = (z - below_z * x - beside * y) / zz
        along_y = y / yy - beside * along_z
        along_x = x / xx - below_y * along_y - below_z * along_z
        at = (weights * value).sum(axis=0) / total
        fits.append((at - mean[0] * along_x - mean[1] * along_y - mean[2] * along_z, along_x, along_y, along_z))
    return fits
