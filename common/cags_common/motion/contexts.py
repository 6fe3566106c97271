"""How large a residual is likely to be, told by what came before: which table codes it.

The parts of a splat come one after the other, the real part of a quaternion last. The numbers that choose a table are
those that encoder and decoder both have.

A residual of a knot that a coarser level has told apart from its guess lies anywhere within that level's unit: neither
neighbours nor samples tell more of it, so these have a table of their own, and count for nobody else.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32
from cags_common.motion.knots import I32, Knot
from cags_common.motion.neighbours import FIRST_FINER, FIRST_GROUPS, MOST_SPREAD, Neighbours, groups

U8 = NDArray[np.uint8]

MAGNITUDE = 63
"""Residuals count for so much at most."""

_EDGES = np.array([0, 4, 9, 16, 28, 50, 100, 200, 440])
"""Bounds of the classes by expected size of a residual, in twentieths."""

CLASSES = len(_EDGES) + 1
_UNKNOWN = 2
"""Class of a residual that nothing came before."""

TOLD = CLASSES
"""Table, after those of the classes, of residuals that a coarser level told apart from their guess."""

REAL_CLASSES = 4
REAL_TOLD = REAL_CLASSES
_REAL_EDGES = np.array([0, 2, 6])
_PARENT, _NEAR = 1, 4
"""What is known of a residual, in parts: its parent, its neighbours."""

_LARGEST = 3 * MAGNITUDE + MOST_SPREAD + 3 * 2 * MAGNITUDE
_WEIGHTS = _PARENT + _NEAR + 3


def runs(splats: int, parts: int) -> NDArray[np.int64]:
    """Residuals of one knot that are coded in one go, one number each time."""
    return np.repeat(np.array([len(group) for group in groups(splats)], np.int64), parts)


@cache
def class_tables() -> U8:
    """[weights, sums] class of a residual: of its parent's magnitudes, its neighbours' spread and thrice the magnitudes
    of the splat's parts before it, by how much of that is known: parent 1, neighbours 4, each part 1.
    """
    made = np.empty((_WEIGHTS, _LARGEST + 1), np.uint8)
    made[0] = _UNKNOWN
    for weight in range(1, _WEIGHTS):
        edges = np.maximum(3 * weight * _EDGES, 1)
        made[weight] = np.searchsorted(edges, 20 * np.arange(_LARGEST + 1), side="right")
    return made


Code = Callable[[U8, I32, int, NDArray[np.intp], int], NDArray[Any]]
"""Codes residuals: class [m], guess [m] and unit (fixed point), rows [m], part -> residuals [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """What is known of the samples [splats, parts] of a knot before one of its levels, fixed point."""

    line: I32
    """What the samples coded before lead to expect."""
    before: I32
    """What the levels before have told."""
    told: NDArray[np.bool_]
    """Whether they told it apart from their guess."""
    unit: int


class Contexts:
    """The contexts of one tree of residuals [splats, parts] a knot; ``turn``: part 0 is the real one."""

    def __init__(self, near: Neighbours, units: F32, parts: int, *, turn: bool) -> None:
        """``units`` [splats] are those of the residuals, by which neighbours compare."""
        self._near, self._units, self._shape, self._first = near, units, (len(near.rows), parts), int(turn)
        self._activity: dict[int, NDArray[np.int64]] = {}

    def walk(self, knot: Knot, row: Row, code: Code) -> tuple[I32, I32]:
        """Samples and residuals [splats, parts] of ``knot``; each run of residuals is as ``code`` says."""
        samples, residuals = (np.zeros(self._shape, np.int32) for _ in range(2))
        activity, off = np.zeros(self._shape[0], np.int64), np.zeros(self._shape, np.float32)
        parent = self._activity.get(knot.parent)
        for number, rows in enumerate(groups(self._shape[0])):
            unit = row.unit // FIRST_FINER if number < FIRST_GROUPS else row.unit
            known = _PARENT * (parent is not None) + _NEAR * (number > 0)
            size = np.zeros(len(rows), np.int64) if parent is None else parent[rows]
            shift, spread = self._near.expected(off, self._units, rows, unit)
            guess = np.where(row.told[rows], row.before[rows], row.line[rows] + shift)
            for part in range(self._first, self._shape[1]):
                sums = size + spread[:, part] + 3 * activity[rows]
                told, table = row.told[rows, part], class_tables()[known + part - self._first, sums]
                table = np.where(told, np.uint8(TOLD), table)
                residuals[rows, part] = code(table, guess[:, part], unit, rows, part)
                activity[rows] += np.where(told, 0, _magnitude(residuals[rows, part]))
            if self._first:
                table = np.searchsorted(_REAL_EDGES, activity[rows], side="left").astype(np.uint8)
                table = np.where(row.told[rows, 0], np.uint8(REAL_TOLD), table)
                residuals[rows, 0] = code(table, guess[:, 0], unit, rows, 0)
            samples[rows] = guess + residuals[rows] * np.int32(unit)
            apart = samples[rows].astype(np.int64) - row.line[rows]
            off[rows] = apart.astype(np.float32) * self._units[rows][:, None]
        self._activity[knot.at] = activity
        return samples, residuals


def _magnitude(residual: I32) -> NDArray[np.int64]:
    return np.minimum(np.abs(residual.astype(np.int64)), MAGNITUDE)
