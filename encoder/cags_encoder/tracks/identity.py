"""Identifies the splats of a frame with those of the previous frame.

Some sources know the identities of splats. If a source does not, or if its identities are evidently wrong, splats are
linked to those of the previous frame (:mod:`cags_encoder.tracks.linking`). A splat without a predecessor is new; one
without a successor has ended. An identity is therefore one unbroken track. If two frames have too few splats in common,
a new group of frames begins.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import takewhile

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle.tracks import TrackStatistics
from cags_common.errors import SceneError
from cags_common.splats import Ids
from cags_encoder.tracks.flow import Rows
from cags_encoder.tracks.hindsight import FRAMES, Linked, corrected
from cags_encoder.tracks.linking import Looks, Tracks, alike, link
from cags_encoder.tracks.looking import Look
from cags_encoder.tracks.statistics import TrackCounter

MIN_OVERLAP = 0.25
"""Smallest share of rows with a predecessor. Below it a key frame costs no more than the differences."""

MIN_ALIKE = 0.8
"""A source's identities are trusted if at least this share of splats is similar to its namesake in the frame before."""


@dataclass(frozen=True, eq=False)
class Identified:
    """A frame [n] with persistent identities."""

    look: Look
    """The last frame's own object where neither splats nor identities differ from it, as in a still scene."""
    ids: NDArray[np.int64]  # [n]
    continuous: bool
    """Whether enough of them continue splats of the previous frame."""


@dataclass(eq=False)
class _Frame:
    """A frame whose links may still be corrected."""

    look: Look
    known: NDArray[np.int64] | None  # [n] the source's own identities, checked
    rows: Rows  # [n] the row of the frame before that each row continues, or -1
    linked: Linked | None
    """How it was linked; None if the source's identities were taken."""


class IdentityTracker:
    """Assigns persistent identities to the rows of frames."""

    def __init__(self) -> None:
        self._ids: NDArray[np.int64] = np.zeros(0, np.int64)
        self._next = 0
        self._look: Look | None = None  # that of the last frame
        self._counter = TrackCounter()

    def follow(self, frames: Iterable[tuple[str, Look]]) -> Iterator[Identified]:
        """Yield ``frames``, which come in order and with names for errors, when later ones have corrected their links.
        Raises :class:`SceneError` if identities of the source repeat.
        """
        window: deque[_Frame] = deque()  # the last frame that was yielded, and those that wait
        for name, look in frames:
            window.append(self._linked(window[-1] if window else None, look, name))
            if len(window) == 1:
                yield self._identified(window[0])
            self._correct(window)
            if len(window) > FRAMES + 1:
                window.popleft()
                yield self._identified(window[0])
        for frame in list(window)[1:]:
            yield self._identified(frame)

    def statistics(self) -> TrackStatistics:
        """Statistics of the tracks so far."""
        return self._counter.statistics()

    def _identified(self, frame: _Frame) -> Identified:
        rows = frame.rows
        found = rows >= 0
        if frame.look is self._look:
            self._counter.add(self._look.splats, self._look.splats, rows)
            return Identified(frame.look, self._ids, True)
        ids = np.empty(len(rows), np.int64)
        ids[found] = self._ids[rows[found]]
        fresh = len(rows) - int(found.sum())
        ids[~found] = np.arange(self._next, self._next + fresh)
        self._next += fresh
        self._counter.add(self._look.splats if self._look else None, frame.look.splats, rows)
        self._ids, self._look = ids, frame.look
        return Identified(frame.look, ids, bool(found.sum() >= MIN_OVERLAP * len(rows)))

    @staticmethod
    def _linked(before: _Frame | None, look: Look, name: str) -> _Frame:
        """``look`` linked to the frame ``before``."""
        if before is not None and before.known is not None and _same(before.look, look):
            return _Frame(before.look, before.known, np.arange(len(look.splats)), None)
        known = None if look.known is None else _checked(look.known, len(look.splats), name)
        if before is None:
            return _Frame(look, known, np.full(len(look.splats), -1, np.intp), None)
        if known is not None and before.known is not None:
            rows = _rows_of(known, before.known)
            if alike(before.look.splats, look.splats, rows) >= MIN_ALIKE:
                return _Frame(look, known, rows, None)
        if before.linked is None:
            seen = Looks.of(before.look.splats)
            before.linked = Linked(seen, before.rows, Tracks.begun(seen))
        after, tracks = Looks.of(look.splats), before.linked.tracks
        rows = link(tracks, after)
        return _Frame(look, known, rows, Linked(after, rows, tracks.continued(after, rows)))

    @staticmethod
    def _correct(window: Sequence[_Frame]) -> None:
        """Correct the links of the frames of ``window`` after the last whose identities the source knew."""
        frames = list(takewhile(lambda frame: frame.linked is not None, reversed(window)))[::-1]
        linked = [frame.linked for frame in frames if frame.linked is not None]
        if len(linked) > 2 and corrected(linked):
            for frame, mine in zip(frames[1:], linked[1:], strict=True):
                frame.rows = mine.rows


def _checked(known: Ids, count: int, source: str) -> NDArray[np.int64]:
    ids = known.astype(np.int64)
    if len(ids) != count or len(np.unique(ids)) != count or ids.min(initial=0) < 0:
        raise SceneError(f"{source}: its splat identities must be distinct, not negative, and one per splat")
    return ids


def _same(before: Look, after: Look) -> bool:
    """Whether a still scene says the same again, without a look at the values."""
    return after.splats is before.splats and after.known is before.known


def _rows_of(ids: NDArray[np.int64], among: NDArray[np.int64]) -> Rows:
    """Index of each of ``ids`` in ``among``, or -1."""
    order = np.argsort(among, kind="stable")
    at = order[np.minimum(np.searchsorted(among, ids, sorter=order), len(among) - 1)]
    return np.where(among[at] == ids, at, -1)
