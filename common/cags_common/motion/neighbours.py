"""What neighbours lead to expect of a splat: those nearest to it in its tile among the ones that are coded before it.

The splats of a knot are coded in groups of halved strides (tiles are in Morton order), so that every later splat has
coded neighbours around it. Neighbours are those of the looks' positions, which a client has before any motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cags_kernels
from cags_common.geometry import F32, F64
from cags_common.motion.knots import I32

STRIDES = (256, 128, 64, 32, 16, 8, 4, 2, 1)
"""The first group are the multiples of the first stride; each further one the odd multiples of its own."""

FIRST_GROUPS, FIRST_FINER = 4, 2
"""The first groups, of which every other splat is predicted, are told in units so many times finer."""

COUNT, FIT = 8, 8
"""Neighbours of a splat, and numbers of each one's part in a fit."""

WINDOW = 16
"""They are sought among so many splats of the groups before, on either side in the tile's order."""

FURTHEST = 64.0
"""Largest distance of a neighbour, in mean distances: one that coincides with the splat has nearly all of the weight,
and the mean would be nearly zero.
"""

RIDGE = 0.1
"""Regularises the slopes (ridge regression), for neighbours in a plane or on a line."""

MOST_SPREAD = 756
"""What the spread of neighbours counts for at most."""

SPREAD = 28.0
"""What a unit of spread counts for."""

MOST_SHIFT = np.float32(1 << 30)
"""Fixed point; no splat is expected further off its line."""

LEAST_UNIT = np.float32(1e-30)
"""Smallest relative unit, so that it can be divided by."""

_TINY = 1e-30
"""Metres, added to distances: splats may coincide."""


@dataclass(frozen=True, slots=True, eq=False)
class Anchors:
    """What motion is told by: the looks that move, as their first level decodes."""

    positions: F32  # [n, 3] world, metres
    moves: F32  # [n] units of positions, metres
    turns: F32  # [n] units of rotations, radians of half an angle

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def nbytes(self) -> int:
        """Bytes of all columns."""
        return self.positions.nbytes + self.moves.nbytes + self.turns.nbytes

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> Anchors:
        """Those of ``rows``."""
        return Anchors(self.positions[rows], self.moves[rows], self.turns[rows])

    def check(self) -> None:
        """Raises ``ValueError`` for numbers that are not finite or arrays that do not fit each other."""
        if not len(self.moves) == len(self.turns) == len(self):
            raise ValueError(f"{len(self.moves)} and {len(self.turns)} units for {len(self)} splats")
        if not all(np.isfinite(column).all() for column in (self.positions, self.moves, self.turns)):
            raise ValueError("positions or units of the looks are not finite")


@dataclass(frozen=True, slots=True, eq=False)
class Neighbours:
    """Of each splat the neighbours that are coded before it, the nearest first, and the linear field through them."""

    rows: I32  # [n, COUNT]
    fits: (
        F32  # [n, COUNT, FIT] share of each; its place, in mean distances; what it adds to the slopes and to the level
    )
    """All zero in the first group, and where there are too few."""

    @staticmethod
    def of(anchors: Anchors, *, native: bool | None = None) -> Neighbours:
        """Those of ``anchors``, which have passed :meth:`Anchors.check`.

        A neighbour's weight is the inverse of its distance and of its unit, which says how exact it is. ``native`` None
        takes the kernel where there is one.
        """
        positions, units = np.ascontiguousarray(anchors.positions), relative(anchors.moves)
        if cags_kernels.native_available() if native is None else native:
            from cags_kernels import motion

            return Neighbours(*motion.neighbours(positions, units))
        rows = np.repeat(np.arange(len(positions), dtype=np.int32)[:, None], COUNT, axis=1)
        fits = np.zeros((len(positions), COUNT, FIT), np.float32)
        for stride, group in zip(STRIDES[1:], groups(len(positions))[1:], strict=True):
            if len(group):
                rows[group], fits[group] = _nearest(positions.astype(np.float64), units, group, 2 * stride)
        return Neighbours(rows, fits)

    def expected(self, off: F32, units: F32, rows: NDArray[np.intp], unit: int) -> tuple[I32, I32]:
        """How far ``rows`` [m] are expected to be off their lines, and how uncertain that is, both [m, parts].

        ``off`` [n, parts] is how far splats are off, times their ``units`` [n]; of splats not yet coded it is not read.
        A linear field is fitted to the neighbours; its value at the splat is multiplied by the share of their energy
        that the field explains. The uncertainty is their mean distance from it, in 1/:data:`SPREAD` of ``unit``.
        """
        near, fits = off[self.rows[rows]], self.fits[rows][:, :, :, None]
        level = _sum(near * fits[:, :, 7])
        slopes = [_sum(near * fits[:, :, 4 + axis]) for axis in range(3)]
        fitted = level[:, None]
        for axis in range(3):
            fitted = fitted + fits[:, :, 1 + axis] * slopes[axis][:, None]
        apart, share = near - fitted, fits[:, :, 0]
        missed, energy = (_sum(_sum(value * value * share)) for value in (apart, near))
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            explained = np.where(missed < energy, np.float32(1) - missed / energy, np.float32(0))
            shift = level * explained[:, None] / units[rows][:, None]
            spread = _sum(np.abs(apart) * share) / units[rows][:, None] * np.float32(SPREAD / unit)
        whole = np.floor(np.where(np.abs(shift) < MOST_SHIFT, shift, np.float32(0)) + np.float32(0.5))
        return whole.astype(np.int32), np.where(spread < MOST_SPREAD, spread, np.float32(MOST_SPREAD)).astype(np.int32)


@cache
def groups(splats: int) -> tuple[NDArray[np.intp], ...]:
    """Splats that are coded together, by group."""
    odd = (np.arange(stride, splats, 2 * stride) for stride in STRIDES[1:])
    return np.arange(0, splats, STRIDES[0]), *odd


def relative(units: F32) -> F32:
    """``units`` [n] in parts of the largest, at least :data:`LEAST_UNIT`; ones where that is none."""
    most = units.max(initial=0.0)
    return np.maximum(units / most, LEAST_UNIT) if most > 0 else np.ones_like(units)


def _nearest(positions: F64, units: F32, group: NDArray[np.intp], step: int) -> tuple[NDArray[np.intp], F64]:
    """Neighbours [m, COUNT] of the splats of a ``group`` among the multiples of ``step``, and their fits."""
    last = (len(positions) - 1) // step
    window = (group // step)[:, None] + np.arange(1 - WINDOW, 1 + WINDOW)
    there = (window >= 0) & (window <= last)
    candidates = np.clip(window, 0, last) * step
    x, y, z = (positions[candidates] - positions[group][:, None]).transpose(2, 0, 1)
    squared = np.where(there, (x * x + y * y) + z * z, np.inf)
    order = np.argsort(squared, axis=1, kind="stable")[:, :COUNT]
    distances = np.sqrt(np.take_along_axis(squared, order, axis=1))
    missing = np.isinf(distances)
    rows = np.where(missing, group[:, None], np.take_along_axis(candidates, order, axis=1))
    finest = units[group].astype(np.float64)[:, None] + _TINY
    weights = (distances[:, :1] + _TINY) / (distances + _TINY) * (finest / (units[rows].astype(np.float64) + _TINY))
    weights = np.where(missing, 0.0, weights)
    shares = weights / _sum(weights)[:, None]
    away = positions[rows] - positions[group][:, None]
    distances[missing] = 0.0
    mean = np.maximum(_sum(shares * distances), distances.max(axis=1) / FURTHEST)
    return rows, _fits(shares, away, mean)


def _fits(shares: F64, away: F64, mean: F64) -> F64:
    """The fits [m, k, 8] of neighbours with ``shares`` [m, k], ``away`` [m, k, 3] metres, ``mean`` [m] of them."""
    place = away / (mean + _TINY)[:, None, None]
    middle = _sum(shares[:, :, None] * place)
    x, y, z = (place - middle[:, None]).transpose(2, 0, 1)
    xx, yy, zz = (_sum(shares * (a * a)) + RIDGE for a in (x, y, z))
    xy, xz, yz = (_sum(shares * (a * b)) for a, b in ((x, y), (x, z), (y, z)))
    inverse = (
        (yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy),
        (xz * yz - xy * zz, xx * zz - xz * xz, xy * xz - xx * yz),
        (xy * yz - xz * yy, xy * xz - xx * yz, xx * yy - xy * xy),
    )
    size = (xx * inverse[0][0] + xy * inverse[0][1]) + xz * inverse[0][2]
    slopes = [
        shares * (((row[0][:, None] * x + row[1][:, None] * y) + row[2][:, None] * z) / size[:, None])
        for row in inverse
    ]
    level = shares - _sum(np.stack([middle[:, axis, None] * slopes[axis] for axis in range(3)], axis=1))
    return np.stack([shares, *place.transpose(2, 0, 1), *slopes, level], axis=2)


def _sum(values: NDArray[Any]) -> NDArray[Any]:
    """Over the second axis, from the first on: the same bits everywhere."""
    total: NDArray[Any] = values[:, 0]
    for at in range(1, values.shape[1]):
        total = total + values[:, at]
    return total
