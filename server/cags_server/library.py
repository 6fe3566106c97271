"""The scene being served: what every client shares. Frames loaded for rendering, and which tile owns which splat."""

from __future__ import annotations

import hashlib
import threading
from bisect import bisect_right
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle import BundleReader, FrameEntry, Manifest
from cags_common.geometry import F32
from cags_common.raster.base import Rasteriser
from cags_common.recent import Recent
from cags_server.scenes import SourceScenes

LOOK_AHEAD, LONGEST_STAY = 8, 60
"""Frames looked ahead for what the media will replace, and the longest stay that detail is credited with."""

OWNER_BYTES, OWNER_FRAMES = 64 << 20, 2 * LOOK_AHEAD
"""Bound on the owner tables in memory, and so many frames' in any case."""


@dataclass(frozen=True, slots=True)
class VisibleTile:
    """A tile and how many of its splats are seen from a pose."""

    frame: int
    tile: int
    count: int
    weight: float
    """Pixels of the reference that its splats make up."""
    frames_left: float
    """Frames until the media replaces those splats, about."""


class SceneLibrary:
    """An opened bundle and the renderer's copies of its frames. Safe to use from several threads."""

    def __init__(self, reader: BundleReader, rasteriser: Rasteriser) -> None:
        self.reader = reader
        self.scenes = SourceScenes(reader, rasteriser)
        self.weights = reader.weights()
        """Of a restorer, trained for this content; clients are offered them."""
        self._owners = Recent[tuple[int, int], NDArray[np.int32]](OWNER_BYTES, least=OWNER_FRAMES)  # by (group, frame)
        self._stays = Recent[int, NDArray[np.uint8]](OWNER_BYTES)  # by frame
        self._numbers: dict[int, tuple[int, ...]] = {}
        self._ids = Recent[tuple[int, int], NDArray[np.intp]](OWNER_BYTES)  # by (frame, tile)
        self._lock = threading.Lock()
        self.digest = hashlib.sha256(reader.manifest.to_json()).hexdigest()[:12]
        """Names the bundle: what a client holds of one is worth nothing for another."""

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

    def prepare(self, frame: int) -> None:
        """Get ready what rendering ``frame`` will need; clients' frames come in order."""
        self.scenes.prepare(frame)
        if frame < self.manifest.frames:
            self.fetch(frame)

    def warm(self) -> None:
        """Load what the first viewer of the first frame will need."""
        self.scenes.warm(0)
        self.fetch(0)

    def at_hand(self, frame: int) -> bool:
        """Whether ``frame`` can be planned and its tiles sent without a read from the store."""
        with self._lock:
            known = (self.manifest.gof_of(frame), frame) in self._owners and frame in self._stays
        return known and self.reader.at_hand(frame)

    def fetch(self, frame: int) -> None:
        """Read what :meth:`at_hand` asks for."""
        self.reader.removed_ids(frame)
        self._frames_left(frame)

    def owners(self, frame: int) -> NDArray[np.int32]:
        """[capacity] for each splat id the tile that holds its newest version at ``frame``; -1 where none does.

        Tiles are numbered through the group of frames; :meth:`tile_of` turns numbers into tiles.
        """
        gof = self.manifest.gof_of(frame)
        with self._lock:
            found = self._owners.get((gof, frame))
            if found is not None:
                return found
            before = max((f for g, f in self._owners if g == gof and f < frame), default=-1)
            nearest = self._owners.get((gof, before))
            known = None if nearest is None else (before, nearest)
        traced = self._trace_owners(gof, frame, known)
        with self._lock:
            self._owners.put((gof, frame), traced, traced.nbytes)
        return traced

    def visible_tiles(self, frame: int, contribution: F32, least: float) -> tuple[VisibleTile, ...]:
        """Tiles that own a splat whose ``contribution`` [capacity] exceeds ``least``, most visible first."""
        owners = self.owners(frame)
        splats = np.nonzero((contribution > least) & (owners >= 0))[0]
        held = owners[splats]
        every = np.bincount(held)
        numbers = np.nonzero(every)[0]
        counts = every[numbers]
        weights = np.bincount(held, weights=contribution[splats])[numbers]
        left = np.bincount(held, weights=self._frames_left(frame)[splats])[numbers] / counts
        rows = zip(numbers.tolist(), counts.tolist(), weights.tolist(), left.tolist(), strict=True)
        tiles = [VisibleTile(*self.tile_of(frame, number), *rest) for number, *rest in rows]
        return tuple(sorted(tiles, key=lambda t: (-t.count, t.frame, t.tile)))

    def _frames_left(self, frame: int) -> NDArray[np.uint8]:
        """[capacity] frames until each splat is replaced, from its owners in the next ``LOOK_AHEAD`` frames.

        A splat that stays that long is taken to stay to the end of its group (at most ``LONGEST_STAY``).
        """
        with self._lock:
            known = self._stays.get(frame)
        if known is not None:
            return known
        last, owners = self.manifest.gof_frames(self.manifest.gof_of(frame))[-1], self.owners(frame)
        left = np.full(len(owners), min(last - frame + 1, LONGEST_STAY), np.uint8)
        for at in range(min(frame + LOOK_AHEAD, last), frame, -1):
            left[self.owners(at) != owners] = at - frame
        with self._lock:
            self._stays.put(frame, left, left.nbytes)
        return left

    def tile_of(self, frame: int, number: int) -> tuple[int, int]:
        """(media frame, tile) of a tile number within the group of ``frame``."""
        firsts = self._first_numbers(self.manifest.gof_of(frame))
        at = bisect_right(firsts, number) - 1
        return self.gof_start(frame) + at, number - firsts[at]

    def _first_numbers(self, gof: int) -> tuple[int, ...]:
        """The number of the first tile of each frame of a group."""
        known = self._numbers.get(gof)
        if known is None:
            sizes = [len(self.entry(frame).tiles) for frame in self.manifest.gof_frames(gof)]
            known = self._numbers[gof] = tuple(accumulate(sizes[:-1], initial=0))
        return known

    def tile_ids(self, frame: int, tile: int) -> NDArray[np.intp]:
        """[n] ids of a tile's splats, for indexing."""
        with self._lock:
            found = self._ids.get((frame, tile))
        if found is None:
            found = self.reader.tile_ids(frame, tile).astype(np.intp)
            with self._lock:
                self._ids.put((frame, tile), found, found.nbytes)
        return found

    def owning_tiles(self, frame: int) -> list[tuple[int, int]]:
        """Every (media frame, tile) that still owns a splat at ``frame``."""
        owners = self.owners(frame)
        return [self.tile_of(frame, int(n)) for n in np.unique(owners[owners >= 0])]

    def _trace_owners(self, gof: int, frame: int, known: tuple[int, NDArray[np.int32]] | None) -> NDArray[np.int32]:
        """Follow removals and tiles from the frame of ``known``, or from the group's start, to ``frame``."""
        start = self.manifest.gof_starts[gof]
        if known is None:
            owners, first = np.full(self.manifest.capacity[gof], -1, np.int32), start
        else:
            owners, first = known[1].copy(), known[0] + 1
        number = self._first_numbers(gof)[first - start]
        for at in range(first, frame + 1):
            owners[self.reader.removed_ids(at)] = -1
            for tile in self.entry(at).tiles:
                owners[self.reader.tile_ids(at, tile.tile)] = number
                number += 1
        return owners
