"""Identifies the splats of a frame with those of the previous frame.

Some sources know the identities of splats. If a source does not, or if its identities are evidently wrong, splats are
linked to those of the previous frame (:mod:`cags_encoder.tracks.linking`). A splat without a predecessor is new; one
without a successor has ended. An identity is therefore one unbroken track. If two frames have too few splats in common,
a new group of frames begins.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle.tracks import TrackStatistics
from cags_common.errors import SceneError
from cags_common.splats import Ids, Splats
from cags_encoder.tracks.linking import Looks, Rows, Tracks, alike, link
from cags_encoder.tracks.statistics import TrackCounter

MIN_OVERLAP = 0.25
"""Smallest share of rows with a predecessor. Below it a key frame costs no more than the differences."""

MIN_ALIKE = 0.8
"""A source's identities are trusted if at least this share of splats is similar to its namesake in the frame before."""


class IdentityTracker:
    """Assigns persistent identities to the rows of frames, which must come in order."""

    def __init__(self) -> None:
        self._ids: NDArray[np.int64] = np.zeros(0, np.int64)
        self._next = 0
        self._splats: Splats | None = None
        self._known: NDArray[np.int64] | None = None
        self._tracks: Tracks | None = None  # of the last frame, if it was linked
        self._counter = TrackCounter()

    def identify(self, splats: Splats, known: Ids | None, source: str) -> tuple[NDArray[np.int64], bool]:
        """Identities [n] of a frame's rows, and whether enough of them continue splats of the previous frame.

        ``known`` [n] are the source's own identities. ``source`` names the frame in errors. Raises :class:`SceneError`
        if identities repeat.
        """
        given = None if known is None else _checked(known, len(splats), source)
        rows = self._rows(splats, given)
        found = rows >= 0
        ids = np.empty(len(rows), np.int64)
        ids[found] = self._ids[rows[found]]
        fresh = len(rows) - int(found.sum())
        ids[~found] = np.arange(self._next, self._next + fresh)
        self._next += fresh
        self._counter.add(self._splats, splats, rows)
        self._ids, self._splats, self._known = ids, splats, given
        return ids, bool(found.sum() >= MIN_OVERLAP * len(rows))

    def statistics(self) -> TrackStatistics:
        """Statistics of the tracks so far."""
        return self._counter.statistics()

    def _rows(self, splats: Splats, given: NDArray[np.int64] | None) -> Rows:
        """The row of the previous frame that each row continues, or -1."""
        if self._splats is None:
            return np.full(len(splats), -1, np.intp)
        if given is not None and self._known is not None:
            rows = _rows_of(given, self._known)
            if alike(self._splats, splats, rows) >= MIN_ALIKE:
                self._tracks = None
                return rows
        before = self._tracks or Tracks.begun(Looks.of(self._splats))
        after = Looks.of(splats)
        rows = link(before, after)
        self._tracks = before.continued(after, rows)
        return rows


def _checked(known: Ids, count: int, source: str) -> NDArray[np.int64]:
    ids = known.astype(np.int64)
    if len(ids) != count or len(np.unique(ids)) != count or ids.min(initial=0) < 0:
        raise SceneError(f"{source}: its splat identities must be distinct, not negative, and one per splat")
    return ids


def _rows_of(ids: NDArray[np.int64], among: NDArray[np.int64]) -> Rows:
    """Index of each of ``ids`` in ``among``, or -1."""
    order = np.argsort(among, kind="stable")
    at = order[np.minimum(np.searchsorted(among, ids, sorter=order), len(among) - 1)]
    return np.where(among[at] == ids, at, -1)
