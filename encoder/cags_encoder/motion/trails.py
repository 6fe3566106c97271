"""States of a group's splats, some frames ahead of the frame that is written."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32
from cags_common.splats import Ids
from cags_encoder.motion.fades import fit_fades, peaks
from cags_encoder.tracks.effect import drawn
from cags_encoder.tracks.lasting import Allowed, bounds, lasting
from cags_encoder.tracks.placing import Placed, Told

PIECE = 65_536
"""Splats whose fades are fitted at a time: each takes some 2 kB."""


@dataclass(frozen=True, eq=False)
class _Moment:
    """All splats at one frame, indexed by id."""

    means: F32  # [capacity, 3]
    quats: F32  # [capacity, 4]
    opacities: F32  # [capacity] drawn, 0 to 1
    alive: NDArray[np.bool_]  # [capacity]


@dataclass(frozen=True, eq=False)
class Window:
    """Some splats [n] over some frames."""

    means: F32  # [frames, n, 3]
    quats: F32  # [frames, n, 4]
    opacities: F32  # [frames, n]
    present: NDArray[np.bool_]  # [frames, n] alive since the first frame

    def ends(self) -> bool:
        """Whether any splat that is there at first has gone by the last frame."""
        return not np.array_equal(self.present[0], self.present[-1])

    def last(self) -> Window:
        """The last frame of the window."""
        return Window(self.means[-1:], self.quats[-1:], self.opacities[-1:], self.present[-1:])


class Trails:
    """Follows frames, group after group, ``span`` frames ahead."""

    def __init__(self, span: int, wrong: float, ease: float = 1.0) -> None:
        """Look ``span`` frames ahead; looks may have a visible error of ``wrong``, and more by ``ease`` if they change
        fast (:func:`cags_encoder.tracks.lasting.ease_of`).
        """
        self._span, self._wrong, self._ease = span, wrong, ease
        self._moments: dict[int, _Moment] = {}
        self._placed: dict[int, Placed] = {}
        self._newest: _Moment | None = None
        self._ends: dict[int, int] = {}  # first frame of a group -> its last known frame
        self._group = 0

    def follow(self, placed: Iterable[Placed]) -> Iterator[Placed]:
        """Yield the same frames, each when the next ``span`` frames, or the rest of its group, are known.

        New splats that fade get their largest opacity, which motion then reduces. Other looks get values that last
        (:mod:`cags_encoder.tracks.lasting`).
        """
        waiting: deque[Placed] = deque()
        for frame in placed:
            if frame.key and waiting:
                yield from self._last(waiting)
            if frame.key:
                self._group, self._newest = frame.index, None
            self._add(frame)
            waiting.append(frame)
            if frame.index - waiting[0].index >= self._span:
                yield self._ready(waiting.popleft(), waiting)
        yield from self._last(waiting)

    def forget(self, frame: int) -> None:
        """Drop the frames before ``frame``."""
        for known in (self._moments, self._placed):
            for old in [at for at in known if at < frame]:
                del known[old]

    def later(self, frame: int) -> list[Placed]:
        """The frames of its group after ``frame``, as many as are looked ahead."""
        last = min(self.last(frame), frame + self._span)
        return [self._placed[at] for at in range(frame + 1, last + 1)]

    def last(self, frame: int) -> int:
        """The last frame of the group of ``frame`` as far as known: at least ``span`` frames ahead."""
        group = max(first for first in self._ends if first <= frame)
        return self._ends[group]

    def window(self, ids: Ids, first: int, last: int) -> Window:
        """States of ``ids`` [n], which exist at frame ``first``, from ``first`` to ``last``."""
        moments = [self._moments[at] for at in range(first, last + 1)]
        alive = np.stack([moment.alive[ids] for moment in moments])
        return Window(
            np.stack([moment.means[ids] for moment in moments]),
            np.stack([moment.quats[ids] for moment in moments]),
            np.stack([moment.opacities[ids] for moment in moments]),
            np.logical_and.accumulate(alive, axis=0),
        )

    def _last(self, waiting: deque[Placed]) -> Iterator[Placed]:
        while waiting:
            yield self._ready(waiting.popleft(), waiting)

    def _add(self, frame: Placed) -> None:
        delta, before = frame.delta, self._newest
        if before is not None and not len(delta.ids) and not len(delta.removed):
            self._keep(frame, before)  # of millions of splats at rest, one copy
            return
        moment = _grown(before, frame.capacity)
        moment.alive[delta.removed] = False
        ids, splats = delta.ids, delta.splats
        moment.means[ids], moment.quats[ids] = splats.means, splats.quats
        moment.opacities[ids], moment.alive[ids] = drawn(splats.logit_opacities), True
        self._keep(frame, moment)

    def _keep(self, frame: Placed, moment: _Moment) -> None:
        self._newest = self._moments[frame.index] = moment
        self._placed[frame.index] = frame
        self._ends[self._group] = frame.index

    def _ready(self, frame: Placed, later: Sequence[Placed]) -> Placed:
        splats, ids, births = frame.delta.splats, frame.delta.ids, np.flatnonzero(frame.births)
        if len(births):
            last = later[-1].index if later else frame.index
            splats = replace(splats, logit_opacities=self._peaks(frame, births, last))
        others = np.flatnonzero(frame.looks & ~frame.births)
        allowed = Allowed(self._wrong, self._ease)
        new = lasting(splats.take(births), ids[births], later, allowed)
        return replace(frame, told=Told(new, bounds(splats.take(others), ids[others], later, allowed, frame.rounded)))

    def _peaks(self, frame: Placed, births: NDArray[np.intp], last: int) -> F32:
        """Opacity logits [m] of the delta's splats; for those of ``births`` that fade, the largest of their life."""
        logits = frame.delta.splats.logit_opacities.copy()
        for first in range(0, len(births), PIECE):
            rows = births[first : first + PIECE]
            logits[rows] = self._raised(frame.delta.ids[rows], logits[rows], frame.index, last)
        return logits

    def _raised(self, ids: Ids, logits: F32, first: int, last: int) -> F32:
        """``logits`` [n] of ``ids`` [n], which appear at frame ``first``; of those that fade, the largest of their life
        up to frame ``last``.
        """
        window = self.window(ids, first, last)
        opacities = window.opacities.astype(np.float64)
        peak = peaks(opacities, window.present)
        middles = (window.present.sum(axis=0) - 1) / 2
        fades, fits = fit_fades(opacities, window.present, peak, middles)
        raised = (fades[:, 0] > 0) & fits
        logits, top = logits.copy(), peak[raised]
        logits[raised] = np.log(top / (1.0 - top))
        return logits


def _grown(before: _Moment | None, capacity: int) -> _Moment:
    """A copy of ``before`` with room for ``capacity`` ids."""
    shapes: list[tuple[int, ...]] = [(capacity, 3), (capacity, 4), (capacity,)]
    means, quats, opacities = (np.zeros(shape, np.float32) for shape in shapes)
    alive = np.zeros(capacity, bool)
    quats[:, 0] = 1.0
    if before is not None:
        known = len(before.alive)
        means[:known], quats[:known], opacities[:known] = before.means, before.quats, before.opacities
        alive[:known] = before.alive
    return _Moment(means, quats, opacities, alive)
