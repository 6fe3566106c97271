"""What splats were before later frames changed them, for a few frames back.

A reference picture shows the scene of its own media frame. To compare it with what the client holds, the client must
draw its splats *as of that frame*, though it may have moved on. Only content counts: an enhancement layer makes a splat
of the same frame better, and is not undone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32
from cags_common.splat_buffer import MOVING_COLUMNS
from cags_common.splats import Splats

Rows = NDArray[np.integer]

_MOVING = frozenset(MOVING_COLUMNS)

MAX_PAST_SPLATS = 1 << 20
"""Bound on the splats that are remembered; past it the oldest frames are forgotten."""


MOVED_SHARE = 8
"""A splat that only moved takes so much less than a whole one of SH degree 3."""


@dataclass(frozen=True, eq=False)
class _Change:
    """Rows [M] that source frame ``frame`` replaced, removed or moved, and what they were: the columns that changed."""

    frame: int
    rows: Rows
    before: dict[str, F32]
    weight: int
    """Whole splats that take as much memory."""

    @property
    def moved(self) -> bool:
        """Whether the rows only moved."""
        return self.before.keys() == _MOVING


@dataclass(frozen=True, eq=False)
class Then:
    """What splats were at an earlier frame."""

    rows: NDArray[np.intp]
    """[M] ascending, of those that have been replaced or removed since."""
    splats: Splats
    """[M] what those were."""
    moved: NDArray[np.intp]
    """[K] ascending, of those that have only moved since."""
    scene: Splats
    """The splats of now, by row, but where all of them were then."""


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

    def record(self, frame: int, rows: Rows, splats: Splats, *, moved: bool = False) -> None:
        """``rows`` [M] of ``splats`` are about to be replaced or removed by source frame ``frame``; ``moved``: or only
        to change their :data:`~cags_common.splat_buffer.MOVING_COLUMNS` on the way to it.
        """
        if not len(rows) or not self.span or frame <= self._known_from:
            return
        last = self._changes[-1] if self._changes else None
        if moved and last is not None and last.frame == frame and last.moved and np.array_equal(last.rows, rows):
            return  # on the way to the same frame: where it came from is known
        before = {name: values.take(rows, axis=0) for name, values in splats.arrays() if not moved or name in _MOVING}
        weight = -(-len(rows) // MOVED_SHARE) if moved else len(rows)
        self._changes.append(_Change(frame, rows.copy(), before, weight))
        self._held += weight
        while self._held > MAX_PAST_SPLATS:
            self._forget(self._changes[0].frame)

    def knows(self, frame: int) -> bool:
        """Whether the scene as of ``frame`` can be told."""
        return frame >= self._known_from

    def changed_since(self, frame: int) -> bool:
        """Whether any splat has changed after ``frame``, as far as is known."""
        return any(change.frame > frame for change in self._changes)

    def as_of(self, frame: int, splats: Splats) -> Then | None:
        """What of ``splats``, those of now, has changed since ``frame``, and what it was; None where nothing has."""
        since = [change for change in self._changes if change.frame > frame]
        if not since:
            return None
        whole = _union([change.rows for change in since if not change.moved])
        columns = {name: getattr(splats, name).copy() for name in MOVING_COLUMNS}
        then, place = splats.take(whole), np.zeros(len(splats), np.intp)
        place[whole] = np.arange(len(whole))
        for change in reversed(since):
            for name, before in change.before.items():
                if name in columns:
                    columns[name][change.rows] = before
                else:
                    getattr(then, name)[place[change.rows]] = before
        moved = np.setdiff1d(_union([change.rows for change in since if change.moved]), whole, assume_unique=True)
        places = {name: column.take(whole, axis=0) for name, column in columns.items()}
        return Then(whole, replace(then, **places), moved, replace(splats, **columns))

    def _forget(self, frame: int) -> None:
        """Nothing before ``frame`` needs to be known."""
        self._known_from = max(self._known_from, frame)
        self._changes = [change for change in self._changes if change.frame > self._known_from]
        self._held = sum(change.weight for change in self._changes)


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
        then = past.as_of(frame, splats)
        if then is None:
            return splats
        columns = dict(then.scene.arrays())
        for name, old in then.splats.arrays():
            if name not in _MOVING:
                columns[name] = columns[name].copy()
                columns[name][then.rows] = old
        return Splats(**columns)


def _union(parts: list[Rows]) -> NDArray[np.intp]:
    return np.unique(np.concatenate([np.zeros(0, np.intp), *parts])).astype(np.intp)
