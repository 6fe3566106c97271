"""Links that later frames correct.

Splats are linked by where their way so far leads (:mod:`cags_encoder.tracks.linking`). Where a clip or a thing begins
there is no way yet, and where a thing bounces it misleads: the way from there on tells more. When a frame has been
linked, doubtful links of the pairs of frames before it are searched again: first backwards in time, then forwards from
where something changed. Two ways to link a pair differ in chains and rings of splats; of each the way is taken that is
smoother, in time and among neighbours.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F64
from cags_encoder.tracks.flow import TINY, Rows, field_at
from cags_encoder.tracks.linking import (
    ACCEPTED,
    APART,
    COMPANIONS,
    LEAST_APART,
    LIMIT,
    Field,
    Looks,
    Tracks,
    differences,
    link,
)

FRAMES = 3
"""Number of frames that have to follow before the links to a frame are final."""

LOOKS = 0.1
"""Weight of differences in looks. Both ways have passed the test of looks; here they decide between equals."""


@dataclass(eq=False)
class Linked:
    """A frame's splats [n], linked to those of the frame before."""

    looks: Looks
    rows: Rows
    """[n] the row of the frame before that each continues, or -1."""
    tracks: Tracks
    """How they came here."""


def corrected(frames: Sequence[Linked]) -> bool:
    """Correct the links between consecutive ``frames``, from the latest pair that is followed by a frame back to the
    earliest as long as something changes, and from there on again to the last. Returns whether anything changed.

    The links to the first of ``frames`` are final.
    """
    first = len(frames)
    for at, back in _ways_back(frames):
        before, now = frames[at - 1], frames[at]
        if not _corrected_by_next(before, now, back):
            break
        first = at
    backs = dict(_ways_back(frames)) if first < len(frames) else {}
    for at in range(first, len(frames)):
        before, now = frames[at - 1], frames[at]
        if at > first:
            _corrected_by_last(before, now, backs.get(at) or Tracks.begun(now.looks))
        now.tracks = before.tracks.continued(now.looks, now.rows)
    return first < len(frames)


def inverse(rows: Rows, count: int) -> Rows:
    """For each of ``count`` rows of the frame before, the row of this frame [n] that continues it, or -1."""
    out = np.full(count, -1, np.intp)
    found = np.flatnonzero(rows >= 0)
    out[rows[found]] = found
    return out


def _ways_back(frames: Sequence[Linked]) -> Iterator[tuple[int, Tracks]]:
    """(frame, tracks to it backwards in time) from the last frame but one to the second; links of later frames are
    looked up when a frame's turn comes.
    """
    back = Tracks.begun(frames[-1].looks)
    for at in range(len(frames) - 2, 0, -1):
        back = back.continued(frames[at].looks, inverse(frames[at + 1].rows, len(frames[at].looks)))
        yield at, back


def _corrected_by_next(before: Linked, now: Linked, back: Tracks) -> bool:
    """Link doubtful splats of ``now`` by where they go, which ``back`` tells. Returns whether anything changed."""
    pair = _Pair(before, now, back)
    doubtful = pair.doubtful()
    trusted = inverse(np.where(doubtful, -1, now.rows), len(before.looks))
    if not doubtful.any() or (trusted >= 0).all():
        return False
    return pair.take_better(inverse(link(back, before.looks, trusted), len(now.rows)))


def _corrected_by_last(before: Linked, now: Linked, back: Tracks) -> None:
    """Link doubtful splats of ``now`` by the ways to the frame ``before``, which have changed."""
    pair = _Pair(before, now, back)
    doubtful = pair.doubtful()
    if doubtful.any():
        pair.take_better(link(before.tracks, now.looks, np.where(doubtful, -1, now.rows)))


@dataclass(frozen=True, eq=False)
class _Pair:
    """Two frames, with the ways that lead to the first and from the second."""

    before: Linked
    now: Linked
    back: Tracks

    @property
    def _unit(self) -> float:
        return max(self.now.looks.spacing, TINY)

    def doubtful(self) -> NDArray[np.bool_]:
        """Mask [n] of the splats of the second frame that have no link, or whose way bends there by more than usual:
        where all bend, nothing tells the wrong ones.
        """
        out = self.now.rows < 0
        linked = np.flatnonzero(~out)
        bends = np.maximum(*self._bends(self.now.rows[linked], linked))
        out[linked] = bends > max(LEAST_APART, APART * float(np.median(bends))) if len(bends) else False
        return out

    def take_better(self, other: Rows) -> bool:
        """Link sets of splats as in ``other`` [n] where that is better. Returns whether it is anywhere.

        A set is what the differences of both ways connect: one splat cannot be linked otherwise without the others.
        """
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        mine, offset = self.now.rows, len(self.now.rows)
        differ = np.flatnonzero(mine != other)
        if not len(differ):
            return False
        linked = [differ[rows[differ] >= 0] for rows in (mine, other)]
        ends = [(splats, rows[splats]) for splats, rows in zip(linked, (mine, other), strict=True)]
        splats, rows = (np.concatenate(part) for part in zip(*ends, strict=True))
        count = offset + len(self.before.looks)
        graph = coo_array((np.ones(len(splats), np.int8), (splats, rows + offset)), shape=(count, count))
        sets = connected_components(graph, directed=False)[1]
        expected = self._with_neighbours(mine == other, np.unique(rows))
        costs, counts = np.zeros((2, sets.max() + 1)), np.zeros((2, sets.max() + 1))
        for way, (splats, rows) in enumerate(ends):
            np.add.at(costs[way], sets[splats], self._cost(rows, splats, expected))
            np.add.at(counts[way], sets[splats], 1)
        costs += ACCEPTED * (counts.max(axis=0) - counts)
        chosen = differ[(costs[1] < costs[0])[sets[differ]]]
        self.now.rows = mine.copy()
        self.now.rows[chosen] = other[chosen]
        return bool(len(chosen))

    def _bends(self, rows: Rows, splats: Rows) -> tuple[F64, F64]:
        """How far ``splats`` [m] of the second frame are from where the ways before and after say, if they continue
        ``rows`` [m], in distances between neighbours. 0 where there is no way.
        """
        step = self.now.looks.means[splats] - self.before.looks.means[rows]
        ways = (self.before.tracks, rows, step), (self.back, splats, -step)
        before, after = (
            np.where(tracks.ages[at] > 0, np.linalg.norm(way - tracks.next_steps[at], axis=1), 0.0) / self._unit
            for tracks, at, way in ways
        )
        return before, after

    def _with_neighbours(self, agreed: NDArray[np.bool_], rows: Rows) -> F64 | None:
        """Places of all splats of the first frame [n, 3], of which ``rows`` have moved as those around them that move
        and on whose links both ways ``agreed`` [n]. None where there are too few of these.
        """
        linked = np.flatnonzero(agreed & (self.now.rows >= 0))
        came, expected = self.now.rows[linked], self.before.looks.means.copy()
        moved = np.zeros_like(expected)
        moved[came] = self.now.looks.means[linked] - expected[came]
        came = came[np.any(moved[came] != 0, axis=1)]
        if len(came) < COMPANIONS:
            return None
        near = Field(expected, came).near(expected[rows], COMPANIONS)[1]
        expected[rows] += field_at(expected[rows], expected, moved, near)
        return expected

    def _cost(self, rows: Rows, splats: Rows, expected: F64 | None) -> F64:
        """Cost [m] of linking ``splats`` to ``rows``, which are ``expected`` [n, 3] at places; that of leaving one
        without a link is :data:`ACCEPTED`.
        """
        off = list(self._bends(rows, splats))
        if expected is not None:
            off.append(np.linalg.norm(self.now.looks.means[splats] - expected[rows], axis=1) / self._unit)
        unevenness = sum((np.minimum(np.square(away), LIMIT) for away in off), np.zeros(len(rows)))
        return unevenness + LOOKS * differences(self.before.looks, self.now.looks, rows, splats)
