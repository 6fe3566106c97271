"""How large a residual is likely to be, told by those that came before: which table codes it, and which sign is likely.

The splats of a knot are coded in groups of halved strides, so that every later splat has coded neighbours on both
sides (tiles are in Morton order); the parts of a splat come one after the other, the real part of a quaternion last.
Everything here is integer arithmetic on what encoder and decoder both have.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cags_common.motion.knots import I32, Knot

U8 = NDArray[np.uint8]

STRIDES = (32, 16, 8, 4, 2, 1)
"""The first group are the multiples of the first stride; each further one the odd multiples of its own."""

MAGNITUDE = 63
"""Residuals count for so much at most."""

_EDGES = np.array([0, 4, 9, 16, 28, 50, 100, 200, 440])
"""Bounds of the classes by expected size of a residual, in twentieths."""

CLASSES = len(_EDGES) + 1
_UNKNOWN = 2
"""Class of a residual that nothing came before."""

REAL_CLASSES = 4
_REAL_EDGES = np.array([0, 2, 6])
_LARGEST = 2 * 3 * MAGNITUDE + 2 * 6 * MAGNITUDE + 3 * 2 * MAGNITUDE
_WEIGHTS = 2 + 4 + 3


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Splats that are coded together, and the neighbours of each that came before; the last may have but the left."""

    rows: NDArray[np.intp]
    left: NDArray[np.intp] | None
    right: NDArray[np.intp] | None


@cache
def _groups(splats: int) -> tuple[Group, ...]:
    made = [Group(np.arange(0, splats, STRIDES[0]), None, None)]
    for stride in STRIDES[1:]:
        rows = np.arange(stride, splats, 2 * stride)
        right = np.where(rows + stride < splats, rows + stride, rows - stride)
        made.append(Group(rows, rows - stride, right))
    return tuple(made)


def runs(splats: int, parts: int) -> NDArray[np.int64]:
    """Residuals of one knot that are coded in one go, one number each time."""
    return np.repeat(np.array([len(group.rows) for group in _groups(splats)], np.int64), parts)


@cache
def class_tables() -> U8:
    """[weights, sums] class of a residual: of twice the parent's and the neighbours' magnitudes plus thrice those of
    the splat's parts before it, by how much of that is known: parent 2, neighbours 4, each part 1.
    """
    made = np.empty((_WEIGHTS, _LARGEST + 1), np.uint8)
    made[0] = _UNKNOWN
    for weight in range(1, _WEIGHTS):
        edges = np.maximum(3 * weight * _EDGES, 1)
        made[weight] = np.searchsorted(edges, 20 * np.arange(_LARGEST + 1), side="right")
    return made


Code = Callable[[U8, NDArray[np.bool_] | None, NDArray[np.intp], int], NDArray[Any]]
"""Codes residuals: class [m], whether the other sign is likelier [m] (None: unknown), rows [m], part -> residuals."""


class Contexts:
    """The contexts of one tree of residuals [splats, parts] a knot; ``turn``: part 0 is the real one."""

    def __init__(self, splats: int, parts: int, *, turn: bool) -> None:
        self._shape, self._first = (splats, parts), int(turn)
        self._activity: dict[int, NDArray[np.int64]] = {}

    def walk(self, knot: Knot, code: Code) -> I32:
        """The residuals [splats, parts] of ``knot``, each run of them as ``code`` says."""
        out, activity = np.zeros(self._shape, np.int32), np.zeros(self._shape[0], np.int64)
        parent = self._activity.get(knot.parent)
        for group in _groups(self._shape[0]):
            rows, known = group.rows, 2 * (parent is not None) + 4 * (group.left is not None)
            told = np.zeros(len(rows), np.int64) if parent is None else 2 * parent[rows]
            if group.left is not None:
                told += 2 * (activity[group.left] + activity[group.right])
            for part in range(self._first, self._shape[1]):
                before = part - self._first
                table = class_tables()[known + before, told + 3 * activity[rows]]
                out[rows, part] = code(table, _flips(out, group, part), rows, part)
                activity[rows] += _magnitude(out[rows, part])
            if self._first:
                table = np.searchsorted(_REAL_EDGES, activity[rows], side="left").astype(np.uint8)
                out[rows, 0] = code(table, _flips(out, group, 0), rows, 0)
        self._activity[knot.at] = activity
        return out


def _magnitude(residual: I32) -> NDArray[np.int64]:
    return np.minimum(np.abs(residual.astype(np.int64)), MAGNITUDE)


def _flips(residuals: I32, group: Group, part: int) -> NDArray[np.bool_] | None:
    """Whether the neighbours' residuals add up to less than nothing."""
    if group.left is None or group.right is None:
        return None
    column = residuals[:, part].astype(np.int64)
    flips: NDArray[np.bool_] = column[group.left] + column[group.right] < 0
    return flips
