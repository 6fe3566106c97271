"""Which ids a frame's splats get, and what changes by id from frame to frame."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle import SourceDelta
from cags_common.bundle.tracks import TrackStatistics
from cags_common.geometry import F32, F64, axis_bounds
from cags_common.splats import Ids, Splats
from cags_common.tiles.morton import morton_order
from cags_encoder.sampling import check_degree
from cags_encoder.tracks.identity import IdentityTracker
from cags_encoder.tracks.looking import Look
from cags_encoder.tracks.rounding import codebooks
from cags_encoder.tracks.rows import SplatTable

MOTION = ("means", "quats")
"""Columns of splats that chunks of motion code."""

LOOKS = ("log_scales", "logit_opacities", "sh0", "sh_rest")
"""The other columns."""

LASTING = ("log_scales", "sh0", "sh_rest")
"""Columns that source frames leave out for splats that keep them."""


@dataclass(frozen=True, eq=False)
class Bound:
    """How far off one attribute of splats [n] may be before it is sent again."""

    wrong: F64
    """[n] visible effect of the largest error of the decoder's copy without an update."""
    worth: F64
    """[n] squared visible error, summed over the frames for which an update lasts, that an update has to save if the
    decoder's copy will do again soon.
    """

    def take(self, rows: NDArray[np.intp]) -> Bound:
        """The bounds of ``rows`` [m]."""
        return Bound(self.wrong[rows], self.worth[rows])


@dataclass(frozen=True, eq=False)
class Told:
    """What is coded of the new splats [b] of a frame, and how exactly others [n] have to look that look different."""

    splats: Splats
    """[b] with the largest opacity of what fades, and looks that last."""
    bounds: Mapping[str, Bound]
    """Column of splats -> how far off it may be before it is sent again."""


@dataclass(frozen=True, eq=False)
class Placed:
    """A frame whose splats have their ids."""

    index: int
    key: bool
    """Whether it begins a group."""
    delta: SourceDelta
    capacity: int
    """One more than the largest id of the group so far."""
    births: NDArray[np.bool_]
    """[m] which of the delta's splats are new."""
    looks: NDArray[np.bool_]
    """[m] which are new, or differ in more than position and rotation."""
    told: Told | None = None
    """What to code of those that look different; None: what is in the delta."""
    rounded: Mapping[str, F32] = field(default_factory=dict)
    """Column of splats -> values that the source rounds it to (:mod:`cags_encoder.tracks.rounding`)."""
    kept: NDArray[np.bool_] | None = None
    """[m] which have the scales and colours of the frame before; None: none."""

    @property
    def source(self) -> SourceDelta:
        """The delta as a source frame stores it: splats that are ``kept`` without their scales and colours."""
        return self.delta if self.kept is None else self.delta.keeping(self.kept)


ROOM = 2.0
"""Largest number of ids for each living splat. With more free ids, those of new splats lie closer together."""

FARTHEST = 4096.0
"""Largest distance from where a splat began, in sizes of the splat; beyond, it counts as another splat. Motion is
relative to the looks, so its numbers grow with that distance, and the accuracy of the splat's tile falls.
"""

SPECK = 25.0
"""Percentile of all sizes. Smaller splats count as having this size, as units of motion do."""


class ClipPlacer:
    """Takes frames in order; starts a group where one is due or where nothing connects to the frame before."""

    def __init__(self, name: str, gof_frames: int) -> None:
        self._name, self._gof_frames = name, gof_frames
        self._tracker, self._placer = IdentityTracker(), Placer()
        self.starts: list[int] = []
        self.low: F64 = np.full(3, np.inf)
        self.high: F64 = np.full(3, -np.inf)
        self.degree: int | None = None

    def place(self, looks: Iterable[tuple[int, Look]]) -> Iterator[Placed]:
        """Ids for the splats of each frame, numbered from 0. Raises :class:`SceneError`."""
        for index, frame in enumerate(self._tracker.follow(self._checked(looks))):
            key = not self.starts or not frame.continuous or index - self.starts[-1] >= self._gof_frames
            if key:
                self._placer = Placer()
                self.starts.append(index)
            splats = frame.look.splats
            delta, births, looked, kept = self._placer.place(splats, frame.ids)
            low, high = axis_bounds(splats.means)
            self.low, self.high = np.minimum(self.low, low), np.maximum(self.high, high)
            rounded = codebooks(splats)
            yield Placed(index, key, delta, self._placer.capacity, births, looked, rounded=rounded, kept=kept)

    def _checked(self, looks: Iterable[tuple[int, Look]]) -> Iterator[tuple[str, Look]]:
        """Names of frames for errors, and the frames, which have one SH degree."""
        for index, seen in looks:
            name = f"{self._name}, frame {index}"
            self.degree = seen.splats.sh_degree if self.degree is None else self.degree
            check_degree(seen.splats, self.degree, name)
            yield name, seen

    def tracks(self) -> TrackStatistics:
        """What the tracks of the frames so far are like."""
        return self._tracker.statistics()


class Placer:
    """Gives the splats of one group's frames their ids, in order. The first frame given is the key frame."""

    def __init__(self) -> None:
        self._table: SplatTable | None = None
        self._last: tuple[Splats, NDArray[np.int64]] | None = None
        self._began: F32 = np.zeros((0, 3), np.float32)  # [capacity, 3] positions of births
        self._least = 0.0  # size of specks
        self._identities: NDArray[np.int64] = np.zeros(0, np.int64)
        self._free: NDArray[np.int64] = np.zeros(0, np.int64)

    @property
    def capacity(self) -> int:
        """One more than the largest id so far."""
        return self._table.capacity if self._table else 0

    def place(
        self, splats: Splats, identities: NDArray[np.int64]
    ) -> tuple[SourceDelta, NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        """What the next frame [n], n >= 1, changes: its rows have persistent ``identities`` [n].

        And of what it changes [m] which splats are new, which look different, new ones included, and which keep their
        scales and colours.
        """
        last, self._last = self._last, (splats, identities)
        if last is not None and last[0] is splats and last[1] is identities:
            nothing = np.zeros(0, np.int32)
            none = np.zeros(0, bool)
            return SourceDelta(nothing, splats.take(slice(0, 0)), nothing), none, none, none
        if self._table is None:
            order = morton_order(splats.means)
            splats, self._identities = splats.take(order), identities[order]
            self._table = SplatTable(splats)
            self._began, self._least = splats.means.copy(), float(np.percentile(_sizes(splats), SPECK))
            every = np.ones(len(splats), bool)
            delta = SourceDelta(np.arange(len(splats), dtype=np.int32), splats, np.zeros(0, np.int32))
            return delta, every, every, ~every
        ids, removed = self._ids(identities, splats)
        order = np.argsort(ids, kind="stable")
        ids, splats = ids[order], splats.take(order)
        new = ~self._table.holds(ids)
        looks = new | self._table.differs(ids, splats, LOOKS)
        differing = looks | self._table.differs(ids, splats, MOTION)
        kept = ~(new | self._table.differs(ids, splats, LASTING))
        self._table.alive[removed] = False
        delta = SourceDelta(ids[differing], splats.take(differing), removed)
        self._table.put(delta.ids, delta.splats)
        self._begin(ids[new], splats.means[new])
        return delta, new[differing], looks[differing], kept[differing]

    def _ids(self, identities: NDArray[np.int64], splats: Splats) -> tuple[Ids, Ids]:
        """Ids of this frame's rows (known ones keep theirs, new ones take free or fresh ids), and the ids that went."""
        lookup = np.argsort(self._identities, kind="stable")
        at = np.searchsorted(self._identities, identities, sorter=lookup)
        at = lookup[np.minimum(at, len(lookup) - 1)]
        assert self._table is not None
        known = self._identities[at] == identities
        known[known] = ~self._strays(at[known].astype(np.int32), splats.take(known))
        gone = self._table.alive.copy()
        gone[at[known]] = False
        removed = np.flatnonzero(gone).astype(np.int32)
        ids = at.astype(np.int32)
        new = np.flatnonzero(~known)
        new = new[morton_order(splats.means[new])]  # ids that rise along the curve: neighbours in a tile are near
        ids[new] = self._fresh_ids(len(new), len(identities))
        top = max(len(self._identities), int(ids.max(initial=-1)) + 1)
        self._identities = np.concatenate([self._identities, np.full(top - len(self._identities), -1)])
        self._identities[removed] = -1
        self._identities[ids] = identities
        self._free = np.union1d(self._free, removed)
        return ids, removed

    def _begin(self, ids: Ids, means: F32) -> None:
        """Note where new splats begin."""
        more = max(int(ids.max(initial=-1)) + 1 - len(self._began), 0)
        self._began = np.concatenate([self._began, np.zeros((more, 3), np.float32)])
        self._began[ids] = means

    def _strays(self, ids: Ids, splats: Splats) -> NDArray[np.bool_]:
        """Whether each splat [n] is too far from where that of ``ids`` [n] began."""
        away = np.abs(splats.means.astype(np.float64) - self._began[ids]).max(axis=1)
        strays: NDArray[np.bool_] = away > FARTHEST * np.maximum(_sizes(splats), self._least)
        return strays

    def _fresh_ids(self, count: int, alive: int) -> Ids:
        """Ids that went in earlier frames (never in this one: a client may apply its removals late), or new ones while
        there are no more than :data:`ROOM` for each of ``alive`` splats: those that lie closest together, since gaps
        between them are what lists of ids cost.
        """
        if not count:
            return np.zeros(0, np.int32)
        first = len(self._identities)
        more = count if first + count <= ROOM * alive else max(count - len(self._free), 0)
        ids = np.concatenate([self._free, np.arange(first, first + more)])
        at = int(np.argmin(ids[count - 1 :] - ids[: len(ids) - count + 1]))
        chosen = ids[at : at + count]
        self._free = np.setdiff1d(self._free, chosen, assume_unique=True)
        return chosen.astype(np.int32)


def _sizes(splats: Splats) -> F64:
    """Standard deviations [n] along the middle axes."""
    sizes: F64 = np.sort(np.exp(np.clip(splats.log_scales.astype(np.float64), -60, 60)), axis=1)[:, 1]
    return sizes
