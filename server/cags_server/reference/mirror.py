"""What one client shows, kept on the server: the client's own store, fed with what was written to the connection.

TCP delivers in order. What was written before a *mark* has come when the client uses a reference that names it, so that
the mirror, brought up to the same mark, holds the client's splats, bit for bit.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeAlias

from cags_common.coding.packing import decode_ids
from cags_common.raster.base import RasterScene
from cags_common.splats import Splats
from cags_common.store.gof_buffer import Committed, GofBuffer
from cags_common.store.tile_decode import Arrival
from cags_common.store.tile_store import TileStore
from cags_common.tiles.inventory import InventoryEntry
from cags_protocol.wire.messages import Buffer, FrameEnd, TileLayers
from cags_server.scene.decoded_tiles import SharedOpener
from cags_server.scene.library import SceneLibrary

MAX_LOG = 16_384
"""Messages that wait for the next reference; past it those of groups of frames that nobody will see again go, and ends
of frames that have ended before.
"""

FOLLOWS_AT = 1_024
"""Waiting messages from which on they are taken in although nothing is compared."""


@dataclass(frozen=True, slots=True)
class _Layers:
    frame: int
    tile: int
    from_lod: int
    sizes: tuple[int, ...]

    def arrival(self) -> Arrival:
        """With payloads of zeros: a mirror's store counts their bytes, as the client's does, and reads none."""
        return Arrival(self.frame, self.tile, self.from_lod, [_zeros(size) for size in self.sizes])


@dataclass(frozen=True, slots=True)
class _End:
    frame: int
    removed: bytes


@dataclass(frozen=True, slots=True)
class _Restart:
    frame: int


def _zeros(count: int) -> memoryview:
    return memoryview(_ZEROS)[:count] if count <= len(_ZEROS) else memoryview(bytes(count))


_ZEROS = bytes(1 << 20)

_Event: TypeAlias = _Layers | _End | _Restart


class Mirror:
    """What one client holds, as the server knows it.

    The event loop reports what was sent and marked; one render job at a time asks for the scene.
    """

    def __init__(self, library: SceneLibrary, threads: int) -> None:
        """``threads`` of decoding and of motion."""
        self._library, self._threads = library, threads
        opener = SharedOpener(library.decoded, threads)
        self._store = TileStore(library.manifest, library.reader.codec, opener=opener)
        self._log: deque[tuple[int, _Event]] = deque()  # what came after which mark
        self._most = MAX_LOG
        self._mark = 0
        self._lock = threading.Lock()
        self._scene: RasterScene | None = None

    # ------------------------------------------------------------------------------------------------------- event loop

    def sent(self, message: TileLayers | FrameEnd, payload: Buffer) -> None:
        """A message was written to its end; in the order in which they were."""
        if isinstance(message, FrameEnd):
            self._append(_End(message.frame, bytes(payload)))
        else:
            self._append(_Layers(message.frame, message.tile, message.from_lod, message.sizes))

    def mark(self) -> int:
        """All that was sent so far belongs to the mark of this number, 1 and up, which is to be written now."""
        with self._lock:
            self._mark += 1
            return self._mark

    def restart(self, frame: int) -> None:
        """The client forgot everything that was sent before the next mark: it jumped to ``frame``."""
        with self._lock:
            self._log.clear()
        self._append(_Restart(frame))

    def resume(self, inventory: Iterable[InventoryEntry]) -> None:
        """Over this connection the client begins with so many LoDs of each tile, and with no end of a frame."""
        layered = self._library.decoded.layered
        for held in sorted(inventory, key=lambda tile: (tile.frame, tile.tile)):  # motion after the looks that it moves
            if held.lods and self._has(held):
                first = 0 if layered else held.lods - 1
                sizes = self._library.decoded.entry((held.frame, held.tile)).lod_bytes[first : held.lods]
                self._append(_Layers(held.frame, held.tile, first, sizes))

    def _has(self, held: InventoryEntry) -> bool:
        """Whether the bundle has what a client says that it holds of it."""
        if not 0 <= held.frame < self._library.manifest.frames:
            return False
        tiles = self._library.entry(held.frame).tiles
        return held.tile < len(tiles) and held.lods <= len(tiles[held.tile].lod_bytes)

    def _append(self, event: _Event) -> None:
        with self._lock:
            self._log.append((self._mark, event))
            if len(self._log) > self._most:
                self._forget_groups()
                self._most = len(self._log) + MAX_LOG

    def _forget_groups(self) -> None:
        """Forget groups of frames that can no longer be displayed, and repeated ends of frames."""
        gof_of, whole = self._library.manifest.gof_of, self._library.manifest.kept_whole
        ended = max((gof_of(event.frame) for _, event in self._log if isinstance(event, _End)), default=0)
        kept: deque[tuple[int, _Event]] = deque()
        ends: set[int] = set()
        for mark, event in self._log:
            if isinstance(event, _Restart):
                ends.clear()
            elif (not whole and gof_of(event.frame) < ended - 1) or (isinstance(event, _End) and event.frame in ends):
                continue
            elif isinstance(event, _End):
                ends.add(event.frame)
            kept.append((mark, event))
        self._log = kept

    # ------------------------------------------------------------------------------------------------------- job thread

    def scene_at(self, frame: int, basis: int) -> RasterScene | None:
        """What the client draws of ``frame`` by mark ``basis``; None where it holds nothing of it.

        Frames and marks rise but for :meth:`restart` and the client's own jumps within what it keeps. The scene is
        the mirror's, and changes with the next call. Raises :class:`~cags_common.errors.BundleError` and
        :class:`~cags_common.errors.DecodeError` for a bundle that cannot be read.
        """
        self._catch_up(basis)
        if not self._store.reaches(frame):
            return None
        store, committed = self._store.commit(frame)
        self._scene = self._updated(store, committed) if store.begun else None
        return self._scene

    def follow(self, frame: int, basis: int) -> None:
        """Take in what was sent by mark ``basis`` without a scene, if much of it waits: ``frame`` is displayed, and
        nothing is compared. Raises as :meth:`scene_at`.
        """
        if len(self._log) < FOLLOWS_AT:
            return
        self._catch_up(basis)
        if self._store.reaches(frame):
            self._store.commit(frame)
            self._scene = None

    @property
    def splats(self) -> Splats | None:
        """Splats of the last :meth:`scene_at`, by id; None if there were none. The next call changes them."""
        store = self._store.on_display
        return store.splats if store is not None and store.begun else None

    @property
    def memory_bytes(self) -> int:
        """What it takes beside the tiles that all mirrors share: splats by id, once more in the renderer."""
        store = self._store.on_display
        scene = sum(array.nbytes for _, array in store.splats.arrays()) if store and self._scene is not None else 0
        return self._store.nbytes + scene

    def _catch_up(self, basis: int) -> None:
        with self._lock:
            events = []
            while self._log and self._log[0][0] < basis:
                events.append(self._log.popleft()[1])
        arrivals: list[Arrival] = []
        for event in events:
            if isinstance(event, _Layers):
                arrivals.append(event.arrival())
                continue
            self._take(arrivals)
            arrivals = []
            if isinstance(event, _End):
                capacity = self._store.capacity(event.frame)
                what = f"removed ids of frame {event.frame}"
                removed = decode_ids(event.removed, what=what, limit=capacity)
                self._store.end(event.frame, removed)
            else:
                self._store.reset(event.frame)
        self._take(arrivals)

    def _take(self, arrivals: list[Arrival]) -> None:
        for error in self._store.add_all(arrivals):
            raise error

    def _updated(self, store: GofBuffer, committed: Committed) -> RasterScene:
        scene = self._scene
        if scene is None or committed.fresh:
            return self._library.rasteriser.load(store.splats)
        if len(committed.moved):
            scene.move(committed.moved, store.splats, self._threads)
        if len(committed.rows):
            scene.update(committed.rows, store.splats, self._threads)
        return scene
