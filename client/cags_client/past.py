"""What splats were before later frames changed them, for a few frames back.

A reference picture shows the scene of its own media frame. To compare it with what the client holds, the client must
draw its splats *as of that frame*, though it may have moved on. Only content counts: an enhancement layer makes a splat
of the same frame better, and is not undone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common.splats import Ids, Splats

MAX_PAST_SPLATS = 1 << 20
"""Bound on the splats that are remembered; past it the oldest frames are forgotten."""


@dataclass(frozen=True, eq=False)
class _Change:
    """Rows [M] that source frame ``frame`` replaced or removed, and what they were."""

    frame: int
    rows: Ids
    before: Splats


class SplatPast:
    """The changes of one group of frames. Not thread-safe: recorded and asked on the display path."""

    def __init__(self, first_frame: int = 0) -> None:
        """Nothing is known from before ``first_frame``."""
        self.span = 0
        """Frames back that are remembered; 0 remembers nothing, and then only the present is known."""
        self._known_from = first_frame
        self._changes: list[_Change] = []
        self._held = 0

    def advance(self, frame: int) -> None:
        """``frame`` comes next: forget what is further back than :attr:`span`. Before recording its changes."""
        self._forget(frame - self.span)

    def restart(self, frame: int) -> None:
        """The play went back to ``frame``, and what is held comes again from the start."""
        self._changes.clear()
        self._held, self._known_from = 0, frame

    def record(self, frame: int, rows: Ids, splats: Splats) -> None:
        """``rows`` [M] of ``splats`` are about to be replaced or removed by source frame ``frame``."""
        if not len(rows) or frame <= self._known_from:
            return
        self._changes.append(_Change(frame, rows.copy(), splats.take(rows)))
        self._held += len(rows)
        while self._held > MAX_PAST_SPLATS:
            self._forget(self._changes[0].frame)

    def knows(self, frame: int) -> bool:
        """Whether the scene as of ``frame`` can be told."""
        return frame >= self._known_from

    def changed_since(self, frame: int) -> bool:
        """Whether any splat has changed after ``frame``, as far as is known."""
        return any(change.frame > frame for change in self._changes)

    def as_of(self, frame: int) -> tuple[NDArray[np.intp], Splats] | None:
        """Rows [M] that have changed since ``frame``, ascending, and what they were then; None where nothing has."""
        since = [change for change in self._changes if change.frame > frame]
        if not since:
            return None
        rows, first = np.unique(np.concatenate([change.rows for change in since]), return_index=True)
        return rows.astype(np.intp), Splats.concatenate([change.before for change in since]).take(first)

    def _forget(self, frame: int) -> None:
        """Nothing before ``frame`` needs to be known."""
        self._known_from = max(self._known_from, frame)
        self._changes = [change for change in self._changes if change.frame > self._known_from]
        self._held = sum(len(change.rows) for change in self._changes)


class EarlierGroups:
    """The splats of groups of frames that were on display before, each as of its last frame, and what they had been."""

    def __init__(self) -> None:
        self._groups: list[tuple[int, Splats, SplatPast]] = []

    def add(self, last_frame: int, splats: Splats, past: SplatPast) -> None:
        """A group was shown up to ``last_frame``, and no longer is. Its ``splats`` are kept as they are."""
        self._groups.append((last_frame, splats, past))
        held = np.cumsum([len(splats) for _, splats, _ in reversed(self._groups)])
        kept = int(np.searchsorted(held, MAX_PAST_SPLATS, side="right"))
        self._groups = self._groups[len(self._groups) - kept :]

    def advance(self, frame: int) -> None:
        """Forget what was last shown before ``frame``."""
        self._groups = [group for group in self._groups if group[0] >= frame]

    def clear(self) -> None:
        """Forget everything."""
        self._groups.clear()

    def knows(self, frame: int) -> bool:
        """Whether the scene as of ``frame`` can be told."""
        return any(past.knows(frame) and frame <= last for last, _, past in self._groups)

    def as_of(self, frame: int) -> Splats:
        """The splats of the group of ``frame``, by row, as of it. Only of a frame that :meth:`knows` knows."""
        _, splats, past = next(g for g in self._groups if g[2].knows(frame) and frame <= g[0])
        change = past.as_of(frame)
        if change is None:
            return splats
        rows, before = change
        arrays = [array.copy() for _, array in splats.arrays()]
        for array, (_, old) in zip(arrays, before.arrays(), strict=True):
            array[rows] = old
        return Splats(*arrays)
