"""Source frames in the renderer: a few scenes that roll forward with the media instead of being loaded anew.

A scene holds one row for each splat id of its group of frames; ids that are not alive are transparent. Moving it to a
later frame writes only the rows that changed since; splats that keep their scales and colours are moved and not
replaced. A scene in use by one client is shared by every client at the same frame; one at another frame moves an idle
scene forward or loads a new one.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle import BundleReader, SourceDelta
from cags_common.raster.base import Rasteriser, RasterScene
from cags_common.runtime.recent import Recent
from cags_common.splats import SH_REST_OF_DEGREE, Splats

IDLE_SCENES = 4
"""Scenes that stay loaded while nobody uses them."""

CACHED_DELTA_BYTES = 256 * 1024 * 1024
"""Source frames kept: those about to be needed, and those that another client, or a loop, needs again."""

AHEAD_FRAMES = 6
"""Source frames read ahead of the one being prepared: as many as a late renderer may have to skip."""

ABSENT_LOGIT = np.float32(-20.0)
"""Opacity logit of an id that is not alive: far below what any renderer draws."""


@dataclass(eq=False)
class _Rolling:
    gof: int
    target: int  # the frame that it is at, or is being moved to
    scene: RasterScene | None = None
    splats: Splats | None = None  # [capacity] by id: what the scene holds
    current: int = -1
    users: int = 0
    moving: threading.Lock = field(default_factory=threading.Lock)


class SourceScenes:
    """The renderer's copies of a bundle's source frames. Safe to use from several threads."""

    def __init__(self, reader: BundleReader, rasteriser: Rasteriser) -> None:
        self._reader, self._rasteriser = reader, rasteriser
        self._scenes: list[_Rolling] = []  # least recently used first
        self._deltas = Recent[int, SourceDelta](CACHED_DELTA_BYTES)
        self._content: dict[int, int] = {}
        self._lock = threading.Lock()

    @contextmanager
    def at(self, frame: int) -> Iterator[RasterScene]:
        """A scene [capacity rows, by splat id] at ``frame``; it does not change while the context is open."""
        with self._moved_to(frame) as rolling:
            assert rolling.scene is not None
            yield rolling.scene

    @contextmanager
    def _moved_to(self, frame: int) -> Iterator[_Rolling]:
        rolling = self._claim(self._content_frame(frame))
        try:
            with rolling.moving:  # those that share it wait for the one that loads or moves it
                self._move(rolling)
            yield rolling
        finally:
            self._release(rolling)

    @property
    def has_room(self) -> bool:
        """Whether more frames may be decoded before anybody needs them."""
        return self._deltas.bytes < CACHED_DELTA_BYTES / 2

    def prepare(self, frame: int, frames: int = AHEAD_FRAMES, *, drawn: bool = True) -> None:
        """Read which splats change in ``frame`` and those after it, ``frames`` in all, ahead of their use. Where
        ``frame`` is to be ``drawn``, its values are read, too.
        """
        manifest = self._reader.manifest
        for at in range(frame, min(frame + frames, manifest.frames)):
            if at not in manifest.gof_starts:
                delta = self._delta(at)
                if drawn and at == frame:
                    _ = delta.looks, delta.places

    def changed(self, frame: int, wanted: NDArray[np.bool_]) -> Splats:
        """Those of the ``wanted`` splats [capacity], by id, that appeared or changed within :data:`AHEAD_FRAMES` up to
        ``frame``, as of their last change; none of those that a group of frames begins with.
        """
        start = self._reader.manifest.gof_starts[self._reader.manifest.gof_of(frame)]
        wanted, found = wanted.copy(), [np.zeros(0, np.int32)]
        for at in range(frame, max(start, frame - AHEAD_FRAMES), -1):
            delta = self._delta(at)
            for ids in (delta.ids, delta.moved_ids):
                found.append(ids[wanted[ids]])
                wanted[found[-1]] = False
        rows = np.concatenate(found)
        if not len(rows):
            return _absent(0, self._reader.manifest.sh_degree)
        with self._moved_to(frame) as rolling:
            assert rolling.splats is not None
            return rolling.splats.take(rows)

    def warm(self, frame: int) -> None:
        """Load the scene that the first viewer will look at, before anybody waits for it."""
        with self.at(frame):
            pass
        self.prepare(frame + 1)

    def __len__(self) -> int:
        return len(self._scenes)

    def _claim(self, frame: int) -> _Rolling:
        gof = self._reader.manifest.gof_of(frame)
        with self._lock:
            group = [s for s in self._scenes if s.gof == gof]
            chosen = next((s for s in group if s.target == frame), None)
            if chosen is None:
                idle = [s for s in group if s.users == 0 and s.target < frame]
                chosen = max(idle, key=lambda s: s.target, default=None)
            if chosen is None:
                chosen = _Rolling(gof, frame)
            else:
                self._scenes.remove(chosen)
            self._scenes.append(chosen)
            chosen.target = frame
            chosen.users += 1
            return chosen

    def _release(self, rolling: _Rolling) -> None:
        with self._lock:
            rolling.users -= 1
            if rolling.current != rolling.target and rolling in self._scenes:  # loading failed
                self._scenes.remove(rolling)
            idle = [s for s in self._scenes if s.users == 0]
            for old in idle[: max(0, len(idle) - IDLE_SCENES)]:
                self._scenes.remove(old)

    def _move(self, rolling: _Rolling) -> None:
        """Move the scene to its target; called by one thread at a time."""
        goal = rolling.target
        if rolling.scene is None or rolling.splats is None:
            start = self._reader.manifest.gof_starts[rolling.gof]
            first = start if goal - start <= AHEAD_FRAMES else goal
            rolling.splats = self._splats(first, self._delta(first) if first == start else None)
            rolling.scene = self._rasteriser.load(rolling.splats)
            rolling.current = first
        if goal > rolling.current:
            changed = _rolled(rolling.splats, [self._delta(frame) for frame in range(rolling.current + 1, goal + 1)])
            for rows, take in zip(changed, (rolling.scene.move, rolling.scene.update), strict=True):
                if len(rows):
                    take(rows, rolling.splats)
        rolling.current = goal

    def _splats(self, frame: int, known: SourceDelta | None) -> Splats:
        """All splats [capacity] of ``frame``, by id; ``known``: what it holds, where that has been decoded already."""
        source = known or self._reader.source(frame)
        capacity = self._reader.manifest.capacity[self._reader.manifest.gof_of(frame)]
        everyone = _absent(capacity, source.splats.sh_degree)
        for (_, rows), (_, values) in zip(everyone.arrays(), source.splats.arrays(), strict=True):
            rows[source.ids] = values
        return everyone

    def _content_frame(self, frame: int) -> int:
        """The newest frame up to ``frame`` that changes any source splat: what lies between looks the same."""
        start = self._reader.manifest.gof_starts[self._reader.manifest.gof_of(frame)]
        with self._lock:
            known = max((f for f in self._content if start <= f <= frame), default=start)
            value = self._content.setdefault(known, known)
        for at in range(known + 1, frame + 1):
            delta = self._delta(at)
            value = at if delta.changes else value
            with self._lock:
                self._content[at] = value
        return value

    def _delta(self, frame: int) -> SourceDelta:
        with self._lock:
            known = self._deltas.get(frame)
        if known is not None:
            return known
        delta = self._reader.source_delta(frame)
        with self._lock:
            self._deltas.put(frame, delta, delta.nbytes)
        return delta


def _rolled(splats: Splats, deltas: Sequence[SourceDelta]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Apply successive changes to ``splats`` [capacity]; values that a later one replaces are not read.

    Returns the rows that only moved, and those whose looks changed.
    """
    last_place, last_looks = np.full((2, len(splats)), -1, np.int32)
    for at, delta in enumerate(deltas):
        last_place[delta.removed], last_looks[delta.removed] = at, -1
        last_place[delta.ids] = last_looks[delta.ids] = last_place[delta.moved_ids] = at
    for at, delta in enumerate(deltas):
        splats.logit_opacities[delta.removed] = ABSENT_LOGIT
        if (now := last_looks[delta.ids] == at).any():
            rows, looks = delta.ids[now], delta.looks
            splats.log_scales[rows], splats.sh0[rows] = looks.log_scales[now], looks.sh0[now]
            splats.sh_rest[rows] = looks.sh_rest[now]
        placed = np.concatenate([delta.ids, delta.moved_ids])
        if (now := last_place[placed] == at).any():
            rows, places = placed[now], delta.places[now]
            splats.means[rows], splats.quats[rows] = places[:, :3], places[:, 3:7]
            splats.logit_opacities[rows] = places[:, 7]
    return np.flatnonzero((last_place >= 0) & (last_looks < 0)), np.flatnonzero(last_looks >= 0)


def _absent(count: int, sh_degree: int) -> Splats:
    """Rows that draw nothing."""
    zeros = np.zeros((count, 3), np.float32)
    quats = np.zeros((count, 4), np.float32)
    quats[:, 0] = 1.0
    rest = np.zeros((count, SH_REST_OF_DEGREE[sh_degree], 3), np.float32)
    return Splats(zeros, quats, zeros - 10, np.full(count, ABSENT_LOGIT), zeros.copy(), rest)
