"""Lifetimes of attributes: for how many frames each splat's values stay before the media replaces them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cags_server.scene.ownership import Owners
from cags_server.scene.tile_map import Numbers

LOOK_AHEAD = 8
"""Frames of lookahead for replacements."""

LONGEST_STAY = 60
"""Upper limit of a tile's lifetime, frames."""

UNCHANGED = 255
"""Lifetime of values that do not change within the lookahead."""

Frames = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Changes:
    """Frames from one frame on until another tile brings what is there: 1 to :data:`LOOK_AHEAD`, or
    :data:`UNCHANGED`.
    """

    looks: Frames  # [capacity]
    updates: Frames | None  # [attributes, capacity]

    @staticmethod
    def of(owners: Sequence[Owners], before: Changes | None) -> Changes:
        """Changes at the frame of the first of ``owners``, which are those of the following frames, :data:`LOOK_AHEAD`
        at most and within the group. ``before``, of the frame before, saves recomputing what stays.
        """
        looks = _changes([each.looks for each in owners], None if before is None else before.looks)
        updates = [each.updates for each in owners if each.updates is not None]
        if not updates:
            return Changes(looks, None)
        return Changes(looks, _changes(updates, None if before is None else before.updates))


@dataclass(frozen=True, eq=False)
class Stays:
    """Frames until the media replaces the values of one frame."""

    looks: Frames  # [capacity]
    updates: Frames | None  # [attributes, capacity]
    end: int
    """The last frame of the group."""
    changes: Changes
    """Results of the lookups for it."""

    @staticmethod
    def of(changes: Changes, looks: Numbers, frame: int, end: int) -> Stays:
        """Lifetimes at ``frame`` of a group that ends with ``end``; ``looks`` [capacity] names each splat's owner."""
        most = min(end - frame + 1, LONGEST_STAY)
        updates = None if changes.updates is None else np.minimum(changes.updates, np.uint8(most))
        return Stays(_extrapolated(changes.looks, looks, most), updates, end, changes)

    @property
    def nbytes(self) -> int:
        """Memory."""
        arrays = (self.looks, self.updates, self.changes.looks, self.changes.updates)
        return sum(array.nbytes for array in arrays if array is not None)


def _changes(owners: Sequence[NDArray[np.int32]], before: Frames | None) -> Frames:
    out: Frames = np.full(owners[0].shape, UNCHANGED, np.uint8) if before is None else before - (before != UNCHANGED)
    if before is None:
        _look_up(owners, out, ...)
        return out
    if len(owners) > LOOK_AHEAD and owners[-1] is not owners[-2]:  # a frame has come into sight
        out[(out == UNCHANGED) & (owners[-1] != owners[-2])] = LOOK_AHEAD
    if (changed := np.nonzero(out == 0)) and len(changed[0]):
        out[changed] = UNCHANGED
        _look_up(owners, out, changed)
    return out


def _look_up(owners: Sequence[NDArray[np.int32]], out: Frames, rows: Any) -> None:
    """Write the number of frames until ``rows`` change to ``out``."""
    now, found = owners[0][rows], out[rows]
    for after in range(len(owners) - 1, 0, -1):
        if owners[after] is not owners[0]:
            found[owners[after][rows] != now] = after
    out[rows] = found


def _extrapolated(changes: Frames, owners: Numbers, most: int) -> Frames:
    """Extrapolate lifetimes beyond the lookahead by the rate at which the splats of a tile went within it.

    If none went, they stay for ``most`` frames, to the end of their group.
    """
    stays = np.minimum(changes, np.uint8(most))
    if most <= LOOK_AHEAD:
        return stays
    outlive = changes == UNCHANGED
    if outlive.all():
        return stays
    tiles = owners + 1
    every = np.bincount(tiles)
    gone = 1.0 - np.bincount(tiles[outlive], minlength=len(every)) / np.maximum(every, 1)
    mean = np.minimum(LOOK_AHEAD / np.maximum(gone, LOOK_AHEAD / most), most).astype(np.uint8)
    mean[0] = most  # where there is no splat
    np.copyto(stays, mean[tiles], where=outlive)
    return stays
