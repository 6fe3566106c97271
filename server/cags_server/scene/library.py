"""The scene being served: what every client shares. frames for rendering, and which tile brings what."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle import BundleReader, FrameEntry, Manifest
from cags_common.geometry import F32
from cags_common.raster.base import Rasteriser
from cags_common.runtime.recent import Recent
from cags_server.scene.decoded_tiles import DECODED_BYTES, DecodedTiles
from cags_server.scene.ownership import Owners, advanced
from cags_server.scene.source_scenes import SourceScenes
from cags_server.scene.stays import LOOK_AHEAD, Changes, Stays
from cags_server.scene.tile_map import TileMap
from cags_server.scene.visible_tiles import Moment, Tally, VisibleTile, all_looks, tiles_of, tiles_of_looks

TALLY_BYTES = 4 << 20
"""Bound on the counts of splats by tile and frame in memory."""

OWNER_BYTES, OWNER_FRAMES = 256 << 20, 2 * LOOK_AHEAD
"""Bound on the owner tables in memory, and so many frames' in any case. Up to 45 frames are looked at in turn, from the
displayed one to the lookahead of the last one planned; if their tables do not fit, each is made several times.
"""

TABLE_BYTES = 64 << 20
"""Bound on the lifetimes in memory, and on tiles' ids."""


class SceneLibrary:
    """An opened bundle and the renderer's copies of its frames. Safe to use from several threads."""

    def __init__(self, reader: BundleReader, rasteriser: Rasteriser, decoded_bytes: int = DECODED_BYTES) -> None:
        """``decoded_bytes`` bound the decoded tiles that the mirrors of its clients share."""
        self.reader, self.rasteriser = reader, rasteriser
        self.scenes = SourceScenes(reader, rasteriser)
        self.decoded = DecodedTiles(reader, decoded_bytes)
        """What clients make of tiles."""
        self.weights = reader.weights()
        """Weights of a restorer trained for this content, offered to clients."""
        base_db = reader.manifest.base_psnr_db
        self.still_errors = _errors(reader.manifest.still_psnr_db, base_db)
        """(frames, squared error relative to the base layer's) if nothing moves for so long; empty if unknown."""
        self.outdated_errors = _errors(reader.manifest.outdated_psnr_db, base_db)
        """The same if updates are missing for so long."""
        self._owners = Recent[tuple[int, int], Owners](OWNER_BYTES, least=OWNER_FRAMES)  # by (group, frame)
        self._stays = Recent[int, Stays](TABLE_BYTES)  # by frame
        self._tallies = Recent[int, Tally](TALLY_BYTES)  # by frame
        self._maps: dict[int, TileMap] = {}  # by group
        self._ids = Recent[tuple[int, int], NDArray[np.intp]](TABLE_BYTES)  # by (frame, tile)
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

    def prepare(self, frame: int, ahead: int, *, drawn: bool) -> None:
        """Read what the plan of ``frame`` will need: its source, with all values if it is to be ``drawn``, and the
        tables for choosing tiles of the frame ``ahead``. Clients' frames come in order.
        """
        self.scenes.prepare(frame, drawn=drawn)
        if ahead < self.manifest.frames:
            self.fetch(ahead)

    def warm(self) -> None:
        """Load what the first viewer of the first frame will need."""
        self.scenes.warm(0)
        self.fetch(0)

    def read_ahead(self, frame: int) -> bool:
        """Get one more frame ready, while nobody watches; False where there is none, or no room for it."""
        if frame >= self.manifest.frames or not self.scenes.has_room or self._owners.bytes > OWNER_BYTES / 2:
            return False
        self.scenes.prepare(frame, 1)
        self.fetch(frame)
        return True

    def at_hand(self, frame: int) -> bool:
        """Whether ``frame`` can be planned and its tiles sent without a read from the store."""
        with self._lock:
            known = (self.manifest.gof_of(frame), frame) in self._owners and frame in self._stays
        return known and self.reader.at_hand(frame)

    def fetch(self, frame: int) -> None:
        """Read what :meth:`at_hand` asks for."""
        self.reader.removed_ids(frame)
        self._stays_at(frame)

    def removed_payload(self, frame: int) -> bytes:
        """What the end of ``frame`` says: the ids that go; none where splats end by the lives in their motion."""
        return b"" if self.manifest.motion is not None else self.reader.removed_payload(frame)

    def owners(self, frame: int) -> NDArray[np.int32]:
        """[capacity] for each splat id the tile that holds its newest looks at ``frame``; -1 where none does.

        Tiles are numbered through the group of frames (:meth:`tile_map`).
        """
        return self.owned(frame).looks

    def owned(self, frame: int) -> Owners:
        """Which tiles hold the newest looks and updates of each splat at ``frame``."""
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
        """Tiles that bring something of a splat whose ``contribution`` [capacity] exceeds ``least``.

        The most visible first: its looks, the motion that it follows and will follow soon, the updates in force.
        """
        splats = np.flatnonzero(contribution > least)
        return self.tiles_of(frame, splats, contribution[splats])

    def tiles_of(self, frame: int, splats: NDArray[np.intp], weights: F32) -> tuple[VisibleTile, ...]:
        """As :meth:`visible_tiles`, of ``splats`` [n], ascending, that contribute ``weights`` [n]."""
        return tiles_of(self._moment(frame), splats, weights)

    def tiles_of_looks(self, frame: int, seen: Tally) -> tuple[VisibleTile, ...]:
        """As :meth:`visible_tiles`, of every splat of the tiles of looks ``seen``."""
        return tiles_of_looks(self._moment(frame), seen)

    def all_looks(self, frame: int) -> Tally:
        """The tiles of looks that have splats at ``frame``, each splat of the weight 1."""
        with self._lock:
            known = self._tallies.get(frame)
        if known is None:
            known = all_looks(self._moment(frame))
            with self._lock:
                self._tallies.put(frame, known, known.numbers.nbytes + 3 * known.counts.nbytes)
        return known

    def _moment(self, frame: int) -> Moment:
        return Moment(frame, self.tile_map(frame), self.owned(frame), self._stays_at(frame))

    def _stays_at(self, frame: int) -> Stays:
        """For how long what is there at ``frame`` stays, from the owners in the next ``LOOK_AHEAD`` frames."""
        with self._lock:
            known = self._stays.get(frame)
        if known is not None:
            return known
        gof = self.manifest.gof_of(frame)
        last = self.manifest.gof_frames(gof)[-1]
        with self._lock:
            before = self._stays.get(frame - 1) if frame > self.manifest.gof_starts[gof] else None
        owners = [self.owned(at) for at in range(frame, min(frame + LOOK_AHEAD, last) + 1)]
        changes = Changes.of(owners, None if before is None else before.changes)
        stays = Stays.of(changes, owners[0].looks, frame, last)
        with self._lock:
            self._stays.put(frame, stays, stays.nbytes)
        return stays

    def tile_map(self, frame: int) -> TileMap:
        """The tiles of the group of ``frame`` by number."""
        gof = self.manifest.gof_of(frame)
        known = self._maps.get(gof)
        if known is None:
            known = self._maps[gof] = TileMap([self.entry(at) for at in self.manifest.gof_frames(gof)])
        return known

    def tile_of(self, frame: int, number: int) -> tuple[int, int]:
        """(media frame, tile) of a tile number within the group of ``frame``."""
        return self.tile_map(frame).key(number)

    def tile_ids(self, frame: int, tile: int) -> NDArray[np.intp]:
        """[n] ids of a tile's splats, for indexing."""
        with self._lock:
            found = self._ids.get((frame, tile))
        if found is None:
            found = self.reader.tile_ids(frame, tile).astype(np.intp)
            with self._lock:
                self._ids.put((frame, tile), found, found.nbytes)
        return found

    def _trace_owners(self, gof: int, frame: int, known: tuple[int, Owners] | None) -> Owners:
        """Follow removals and tiles from the frame of ``known``, or from the group's start, to ``frame``."""
        tiles = self.tile_map(frame)
        if known is None:
            owners, first = Owners.none(self.manifest.capacity[gof], updates=tiles.has_updates), tiles.start
        else:
            owners, first = known[1], known[0] + 1
        for at in range(first, frame + 1):
            owners = advanced(owners, self.reader, tiles, at)
        return owners


def _errors(psnr_db: Sequence[tuple[int, float]], base_db: float | None) -> tuple[tuple[float, float], ...]:
    if base_db is None:
        return ()
    return tuple((float(frames), 10.0 ** ((base_db - each_db) / 10.0)) for frames, each_db in psnr_db)
