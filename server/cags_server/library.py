"""The scene being served: what every client shares. Frames loaded for rendering, and which tile owns which splat."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle import BundleReader, FrameEntry, Manifest
from cags_common.geometry import F32
from cags_common.raster.base import Rasteriser, RasterScene
from cags_common.splats import Ids

LOADED_FRAMES = 8
"""Frames that stay loaded in the renderer: clients at the same moment of the media share one."""

OWNER_FRAMES = 64
"""Frames whose owner tables stay in memory."""

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class VisibleTile:
    """A tile and how many of its splats are seen from a pose."""

    frame: int
    tile: int
    count: int


@dataclass(frozen=True, eq=False)
class LoadedFrame:
    """The unquantised splats of one frame, ready to render."""

    ids: Ids  # [M] id of each splat of the scene
    scene: RasterScene  # [M] splats


class _Cache(Generic[T]):
    """Least-recently-used values that are made once, however many threads ask at the same time."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._values: OrderedDict[Hashable, T] = OrderedDict()
        self._making: dict[Hashable, threading.Lock] = {}
        self._lock = threading.Lock()

    def get(self, key: Hashable, make: Callable[[], T]) -> T:
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
                return self._values[key]
            making = self._making.setdefault(key, threading.Lock())
        with making:
            with self._lock:
                if key in self._values:
                    return self._values[key]
            value = make()
            with self._lock:
                self._values[key] = value
                self._making.pop(key, None)
                while len(self._values) > self._size:
                    self._values.popitem(last=False)
            return value

    def newest_below(self, key: tuple[int, int]) -> tuple[tuple[int, int], T] | None:
        """The cached entry of the same first part with the largest second part below that of ``key``."""
        with self._lock:
            known = [k for k in self._values if isinstance(k, tuple) and k[0] == key[0] and k[1] < key[1]]
            best = max(known, default=None)
            return None if best is None else (best, self._values[best])


class SceneLibrary:
    """An opened bundle and the renderer's copies of its frames. Safe to use from several threads."""

    def __init__(self, reader: BundleReader, rasteriser: Rasteriser) -> None:
        self.reader = reader
        self.rasteriser = rasteriser
        self._loaded: _Cache[LoadedFrame] = _Cache(LOADED_FRAMES)
        self._owners: _Cache[NDArray[np.int32]] = _Cache(OWNER_FRAMES)
        self._sources: dict[int, int] = {}
        self._sources_lock = threading.Lock()

    @property
    def manifest(self) -> Manifest:
        """The bundle's manifest."""
        return self.reader.manifest

    def entry(self, frame: int) -> FrameEntry:
        """Tiles and sizes of a frame."""
        return self.reader.frame(frame)

    def gof_start(self, frame: int) -> int:
        """The key frame that ``frame`` builds on."""
        return self.manifest.gof_starts[self.manifest.gof_of(frame)]

    def loaded(self, frame: int) -> LoadedFrame:
        """The source splats of ``frame``, loaded into the renderer; frames that change nothing share one copy."""
        source = self._source_frame(frame)
        return self._loaded.get(source, lambda: self._load(source))

    def owners(self, frame: int) -> NDArray[np.int32]:
        """[capacity] for each splat id the tile that holds its newest version at ``frame``; -1 where none does.

        Tiles are numbered through the group of frames; :meth:`visible_tiles` turns numbers into tiles.
        """
        gof = self.manifest.gof_of(frame)
        return self._owners.get((gof, frame), lambda: self._trace_owners(gof, frame))

    def visible_tiles(self, frame: int, contribution: F32, least: float) -> tuple[VisibleTile, ...]:
        """Tiles that own a splat whose ``contribution`` [M] (as loaded) exceeds ``least``, most visible first."""
        seen = self.loaded(frame).ids[contribution > least]
        owners = self.owners(frame)[seen]
        counts = np.bincount(owners[owners >= 0])
        numbers = np.flatnonzero(counts)
        tiles = [VisibleTile(*self.tile_of(frame, int(n)), int(counts[n])) for n in numbers]
        return tuple(sorted(tiles, key=lambda t: (-t.count, t.frame, t.tile)))

    def tile_of(self, frame: int, number: int) -> tuple[int, int]:
        """(media frame, tile) of a tile number within the group of ``frame``."""
        at = self.gof_start(frame)
        while number >= len(self.entry(at).tiles):
            number -= len(self.entry(at).tiles)
            at += 1
        return at, number

    def owning_tiles(self, frame: int) -> list[tuple[int, int]]:
        """Every (media frame, tile) that still owns a splat at ``frame``."""
        owners = self.owners(frame)
        return [self.tile_of(frame, int(n)) for n in np.unique(owners[owners >= 0])]

    def _load(self, frame: int) -> LoadedFrame:
        source = self.reader.source(frame)
        return LoadedFrame(source.ids, self.rasteriser.load(source.splats))

    def _source_frame(self, frame: int) -> int:
        """The newest frame up to ``frame`` that changes any source splat."""
        with self._sources_lock:
            if frame not in self._sources:
                start = self.gof_start(frame)
                known = max((f for f in self._sources if start <= f < frame), default=start)
                value = self._sources.setdefault(known, known)
                for at in range(known + 1, frame + 1):
                    delta = self.reader.source_delta(at)
                    value = at if len(delta.ids) or len(delta.removed) else value
                    self._sources[at] = value
            return self._sources[frame]

    def _trace_owners(self, gof: int, frame: int) -> NDArray[np.int32]:
        known = self._owners.newest_below((gof, frame))
        start = self.manifest.gof_starts[gof]
        if known is None:
            owners = np.full(self.manifest.capacity[gof], -1, np.int32)
            first = start
        else:
            owners, first = known[1].copy(), known[0][1] + 1
        number = sum(len(self.entry(f).tiles) for f in range(start, first))
        for at in range(first, frame + 1):
            owners[self.reader.removed_ids(at)] = -1
            for tile in self.entry(at).tiles:
                owners[self.reader.tile_ids(at, tile.tile)] = number
                number += 1
        return owners
