"""Tiles as clients decode them, decoded once for all the mirrors of a scene.

A mirror (:mod:`cags_server.reference.mirror`) runs the client's store; its tiles are handles that name their levels and
take no memory. What the levels decode to is made when the store is about to show it, from the bundle's payloads, which
are those that were sent, and shared between all mirrors: the arrays never change.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle import BundleReader, TileEntry
from cags_common.bundle.codecs import WHOLE_TILES_CODEC, AnyTile, MotionTile
from cags_common.errors import DecodeError
from cags_common.geometry import F32
from cags_common.motion.apply import Steps
from cags_common.motion.chunk import Chunk
from cags_common.runtime.recent import Recent
from cags_common.splats import Ids, Splats
from cags_common.store.motions import LooksValue, UpdateValues
from cags_common.store.tile_decode import First, Key, Opened, OpenMotion, OpenTile, OpenUpdate, Sphere
from cags_common.tiles.kinds import TileKind
from cags_common.tiles.updates import Change, UpdateState

T = TypeVar("T")
U = TypeVar("U")

DECODED_BYTES = 256_000_000
"""Bound on the decoded tiles that are kept, where the settings say nothing else."""

DECODER_SPLAT_BYTES = 80
"""What a decoder of looks or updates keeps a splat besides its values: codes, positions, what is yet to be merged."""

Value: TypeAlias = LooksValue | UpdateValues | Chunk


@dataclass(frozen=True, eq=False)
class Decoded:
    """Some levels of a tile. Nothing of it changes any more."""

    state: AnyTile
    value: Value

    @property
    def nbytes(self) -> int:
        """What it takes."""
        value, arrays = self.value, list[NDArray[Any]]()
        if isinstance(value, LooksValue):
            arrays = [value.ids, *(array for _, array in value.splats.arrays())]
        elif isinstance(value, Chunk):
            arrays = [array for array in (value.moves, value.turns, value.lives, value.fades) if array is not None]
        else:
            arrays = [array for change in value.values() for array in (change.ids, change.values, change.frames)]
        kept = self.state.nbytes if isinstance(self.state, MotionTile) else DECODER_SPLAT_BYTES * len(self.state)
        return sum(array.nbytes for array in arrays) + kept


class DecodedTiles:
    """Decoded tiles of one bundle, those that were used of late. Safe to use from several threads."""

    def __init__(self, reader: BundleReader, max_bytes: int = DECODED_BYTES) -> None:
        self._reader = reader
        self._recent = Recent[tuple[Key, int], Decoded](max_bytes)
        self._making: dict[tuple[Key, int], Future[Decoded]] = {}
        self._lock = threading.Lock()
        self._pool = ThreadPoolExecutor(os.cpu_count(), "cags-decoded")  # its threads begin with the first work
        self.layered = reader.manifest.codec != WHOLE_TILES_CODEC
        """Whether levels add up; else each is the whole tile."""
        self.made = 0
        """Times that levels were decoded."""

    @property
    def nbytes(self) -> int:
        """Bytes of all tiles kept."""
        return self._recent.bytes

    def forget(self) -> None:
        """Drop all tiles; they are decoded again when needed."""
        with self._lock:
            self._recent.clear()

    def entry(self, key: Key) -> TileEntry:
        """What the bundle's index says of a tile."""
        return self._reader.frame(key[0]).tiles[key[1]]

    def at(self, key: Key, levels: int, before: int = 0) -> Decoded:
        """Tile ``key`` of the levels whose bits are set in ``levels``, made at most once at a time.

        ``before``: fewer levels of it, on which may be built where they are kept. Raises :class:`DecodeError`.
        """
        name = key, levels
        with self._lock:
            known, making = self._recent.get(name), self._making.get(name)
            if known is not None:
                return known
            mine: Future[Decoded] | None = None
            if making is None:
                making = mine = self._making[name] = Future()
        if mine is None:
            return making.result()
        try:
            made = self._made(key, levels, before)
        except BaseException as error:
            mine.set_exception(error)
            raise
        else:
            mine.set_result(made)
            with self._lock:
                self.made += 1
                self._recent.put(name, made, made.nbytes)
            return made
        finally:
            with self._lock:
                del self._making[name]

    def run(self, work: Callable[[T], U], items: Sequence[T], threads: int) -> list[U]:
        """``work`` on each of ``items``, in order; on several threads where ``threads`` are more than one."""
        return list(self._pool.map(work, items) if threads > 1 and len(items) > 1 else map(work, items))

    def _made(self, key: Key, levels: int, before: int) -> Decoded:
        with self._lock:
            known = self._recent.get((key, before)) if before and before & levels == before else None
        first = 0 if self.layered else levels.bit_length() - 1
        state: AnyTile
        if known is not None and self.layered:
            state, lacking = known.state.fork(), levels & ~before
        else:
            state, lacking = self._reader.open_tile(*key, first), levels & ~1
        for lod in range(1, levels.bit_length()) if self.layered else ():
            if lacking >> lod & 1:
                state.add_layer(lod, self._reader.payload(*key, lod))
        return Decoded(state, _value(state))


def _value(state: AnyTile) -> Value:
    if isinstance(state, MotionTile):
        return state.chunk
    if isinstance(state, UpdateState):
        return state.values()
    splats = state.dequantise()
    return LooksValue(state.ids, splats, state.steps, state.grows)


class SharedTile:
    """A tile of a mirror: which levels of it the client holds. Payloads are not looked at."""

    def __init__(self, tiles: DecodedTiles, key: Key, lod: int) -> None:
        self._tiles, self._key = tiles, key
        self._levels, self._decoded = 1 << lod, 0  # now, and when values were asked for last

    def __len__(self) -> int:
        return self._tiles.entry(self._key).splats

    @property
    def lod(self) -> int:
        """Highest LoD up to which everything has come."""
        if not self._tiles.layered:
            return self._levels.bit_length() - 1
        return (~self._levels & (self._levels + 1)).bit_length() - 2

    def add_layer(self, lod: int, payload: bytes | memoryview) -> bool:
        """Take LoD ``lod``; whether it is new."""
        del payload
        before, self._levels = self._levels, self._levels | 1 << lod
        return self._levels != before

    def _value(self) -> Value:
        value = self._tiles.at(self._key, self._levels, self._decoded).value
        self._decoded = self._levels
        return value


class SharedLooks(SharedTile):
    """A tile of looks of a mirror (:class:`~cags_common.bundle.codecs.TileDecoder`)."""

    kind = TileKind.LOOKS
    steps: Steps | None = None
    grows = False
    ids: Ids = np.zeros(0, np.int32)
    """As :attr:`steps` and :attr:`grows` those of the levels that were dequantised last; none before."""

    @property
    def means(self) -> F32:
        """Positions [n, 3] as LoD 0 tells them, world, metres."""
        state = self._tiles.at(self._key, 1).state
        assert not isinstance(state, MotionTile | UpdateState)
        return state.means

    def fork(self) -> SharedLooks:
        """Another handle on the same levels."""
        return copy(self)

    def reduced(self, lods: int) -> SharedLooks:
        """Another handle, on LoDs 0 .. ``lods`` - 1."""
        other = copy(self)
        other._levels &= (1 << lods) - 1
        return other

    def dequantise(self, into: Splats | None = None) -> Splats:
        """The splats [n]; those of every mirror with the same levels, not to be written to."""
        value = self._value()
        assert isinstance(value, LooksValue)
        self.ids, self.steps, self.grows = value.ids, value.steps, value.grows
        return value.splats.written_to(into)


class SharedMotion(SharedTile):
    """A tile of motion of a mirror (:class:`~cags_common.bundle.codecs.MotionDecoder`)."""

    @property
    def looks(self) -> Key:
        """Media frame and tile of the looks that move."""
        looks = self._tiles.entry(self._key).looks
        assert looks is not None
        return looks

    @property
    def chunk(self) -> Chunk:
        """The motion, at the levels up to which everything has come."""
        value = self._value()
        assert isinstance(value, Chunk)
        return value

    def fork(self) -> SharedMotion:
        """Another handle on the same levels."""
        return copy(self)


class SharedUpdate(SharedTile):
    """An update of a mirror (:class:`~cags_common.bundle.codecs.UpdateDecoder`)."""

    ids: Ids = np.zeros(0, np.int32)
    """None: they are checked when the update is read."""

    def values(self) -> dict[str, Change]:
        """Column of splats -> change, at the levels there are."""
        value = self._value()
        assert isinstance(value, dict)
        return value

    def fork(self) -> SharedUpdate:
        """Another handle on the same levels."""
        return copy(self)

    def reduced(self, lods: int) -> SharedUpdate:
        """Another handle, on LoDs 0 .. ``lods`` - 1."""
        other = copy(self)
        other._levels &= (1 << lods) - 1
        return other


class SharedOpener:
    """Makes a mirror's tiles (:class:`~cags_common.store.tile_decode.Opener`)."""

    bounded = False

    def __init__(self, tiles: DecodedTiles, threads: int) -> None:
        self._tiles, self.threads = tiles, threads

    def opened(self, firsts: Sequence[First]) -> list[Opened | DecodeError]:
        """A handle for each tile."""
        return [self._opened(first) for first in firsts]

    def looks_of(self, first: First) -> Key | None:
        """The looks that a tile of motion moves, as the bundle's index says."""
        return None if first.lod else self._tiles.entry(first.key).looks

    def kept(self, payload: memoryview) -> memoryview:
        """The same: it is nobody's buffer."""
        return payload

    def run(self, work: Callable[[T], U], items: Sequence[T]) -> list[U]:
        """``work`` on each of ``items``, in order."""
        return self._tiles.run(work, items, self.threads)

    def _opened(self, first: First) -> Opened:
        entry = self._tiles.entry(first.key)
        if entry.kind == TileKind.MOTION:
            return OpenMotion(SharedMotion(self._tiles, first.key, first.lod))
        if entry.kind == TileKind.UPDATE:
            return OpenUpdate(SharedUpdate(self._tiles, first.key, first.lod))
        low, high = np.array(entry.bounds, np.float32)
        sphere = Sphere((low + high) / 2, float(np.linalg.norm(high - low) / 2))
        return OpenTile(SharedLooks(self._tiles, first.key, first.lod), sphere)
