"""The received tiles of one group of frames, of any kind and depth, in any order of arrival.

Tiles are decoded on arrival, off the display path and in batches, and then *staged*: dequantised, ready for display.
Replaced and expired tiles are kept, within bounds, so that earlier frames can be shown again.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TypeAlias

from cags_common.bundle.codecs import MotionDecoder, TileDecoder
from cags_common.errors import DecodeError
from cags_common.motion.chunk import LEVELS as MOTION_LEVELS
from cags_common.splats import Ids
from cags_common.store.motions import (
    KeptPayload,
    Motions,
    Staged,
    StoredMotion,
    StoredTile,
    StoredUpdate,
    named,
    staged,
    to_stage,
)
from cags_common.store.reorder_buffer import WaitingLayers
from cags_common.store.shown import StoredLooks
from cags_common.store.tile_decode import Arrival, First, Key, Opened, Opener, OpenMotion, OpenTile, OpenUpdate
from cags_common.store.versions import Versions
from cags_common.tiles.inventory import InventoryEntry

MAX_LATE_BYTES = 8 << 20
"""Largest number of layers of replaced tiles kept for replays; beyond it none are kept."""

MAX_TILES_PER_GOF = 1 << 17
"""Largest number of tiles in one group of frames."""

MAX_KEPT_SPLATS = 1 << 22
"""Largest number of splats of replaced tiles and updates kept for replays; beyond it none are kept."""

KEPT_SPLAT_BYTES = 40
"""Memory of a kept splat, bytes; payloads of motion are converted to splats by it."""

REPLAY_AHEAD = 8
"""Number of frames ahead of the display for which kept tiles are dequantised off the display path."""

Layers: TypeAlias = list[tuple[int, memoryview]]
Ahead: TypeAlias = "dict[Key, tuple[memoryview, Opened | DecodeError]]"
"""Tiles that are open already, and the payload that opened each."""


class GofTiles:
    """Tiles of one group of frames. One thread may add and flush while another takes staged tiles."""

    def __init__(
        self,
        frames: range,
        capacity: int,
        opener: Opener,
        *,
        layered: bool = True,
        in_motion: bool = False,
        mark: int = 0,
    ) -> None:
        """Tiles of media ``frames`` with ids below ``capacity``. ``layered`` is false if any payload is a whole tile;
        ``in_motion`` is true if the bundle has motion; ``mark`` is the last mark received.
        """
        self._frames, self._capacity, self._opener = frames, capacity, opener
        self._layered, self._in_motion = layered, in_motion
        self.mark = mark
        """New tiles belong to all marks after this one. Set by the adding thread, after a flush."""
        self.keeps = True
        """Whether the held tiles suffice to show earlier frames of the group again."""
        self._tiles: dict[Key, StoredTile | None] = {}  # None: no longer shown, and not kept
        self._motions = Motions()
        self._late: dict[Key, list[tuple[int, int, bytes | memoryview]]] = {}  # of kept tiles, by mark and level
        self._replay: dict[Key, StoredTile] = {}
        self._kept_splats = self._late_bytes = self._motion_bytes = self._updated_splats = 0
        self._waiting = WaitingLayers(opener.kept)
        self._dropped: list[InventoryEntry] = []
        self._touched: dict[Key, StoredTile] = {}
        self._errors: list[DecodeError] = []
        self._staged: dict[Key, list[Staged]] = {}  # a tile's in the order of marks
        self._several: dict[Key, StoredTile] = {}  # of which versions may be over
        self._horizon, self._basis = -1, math.inf  # of what is shown
        self._floor = -math.inf  # no mark before it is asked for any more
        self._lock = threading.Lock()
        self._decoding = threading.Lock()

    # ------------------------------------------------------------------------------------------ arrival (decode thread)

    def add(self, arrivals: Sequence[Arrival]) -> list[DecodeError]:
        """Decode layers of tiles and return the errors of skipped ones. Duplicates change nothing.

        Damaged payloads, ids beyond the group's capacity and motion that does not fit its looks are skipped; earlier
        levels stay. The result does not depend on how arrivals are batched.
        """
        errors = []
        with self._decoding:
            ahead = self._open_ahead(arrivals)
            for arrival in arrivals:
                try:
                    self._add(arrival.key, list(enumerate(arrival.payloads, arrival.from_lod)), ahead)
                except DecodeError as error:
                    errors.append(error)
        return errors

    def flush(self) -> list[DecodeError]:
        """Dequantise and stage the tiles that :meth:`add` touched, each once, and return the errors of skipped ones.

        Skipped are tiles whose ids grew beyond the capacity and motion that does not fit the looks it waited for. In a
        replay, only tiles that are shown, or soon will be, are staged.
        """
        with self._decoding:
            self._stage(math.inf, self._horizon + REPLAY_AHEAD)
            errors, self._errors = self._errors, []
        return errors

    def take_dropped(self) -> list[InventoryEntry]:
        """Tiles discarded for lack of memory since the last call; the server may send them again."""
        with self._decoding:
            dropped, self._dropped = self._dropped, []
        return dropped

    def resumed(self, inventory: Mapping[Key, int] | None) -> GofTiles:
        """A new store with the LoDs of ``inventory`` (None: those of :meth:`held`) and nothing else.

        A new connection begins from it, whatever the previous one has shown; incomplete levels are forgotten. What the
        inventory has and the store has not, as motion that waited for its looks, :meth:`take_dropped` tells of.
        """
        layered, in_motion = self._layered, self._in_motion
        other = GofTiles(
            self._frames, self._capacity, self._opener, layered=layered, in_motion=in_motion, mark=self.mark
        )
        with self._decoding, self._lock:
            other._horizon = self._horizon
            levels = {key: held.lods for key, held in self._tiles.items() if held is not None}
            if inventory is not None:
                levels = {key: inventory[key] for key in levels if inventory.get(key)}
            for key, lods in sorted(levels.items()):
                held = self._tiles[key]
                if isinstance(held, StoredLooks):
                    self._hand_over_looks(held, lods, other)
                elif isinstance(held, StoredUpdate):
                    state = held.versions.newest
                    update = StoredUpdate(key, Versions(state.reduced(min(lods, state.lod + 1)), self.mark))
                    other._replay[key] = other._take_update(update)
            moving = [held for key in sorted(levels) if isinstance(held := self._tiles[key], StoredMotion)]
        for motion in moving:
            lods = min(motion.lods, levels[motion.key])
            payloads = [memoryview(motion.payloads[level].data) for level in range(lods)]
            other._errors += other.add([Arrival(*motion.key, 0, payloads)])
        if inventory is not None:
            kept = {(tile.frame, tile.tile): tile.lods for tile in other.held()}
            mine = {key: lods for key, lods in inventory.items() if key[0] in self._frames}
            lacking = {key: kept.get(key, 0) for key, lods in mine.items() if kept.get(key, 0) < lods}
            other._dropped += [InventoryEntry(*key, lods) for key, lods in lacking.items()]
        return other

    def _hand_over_looks(self, held: StoredLooks, lods: int, other: GofTiles) -> None:
        state = held.versions.newest.fork()
        late = self._late.get(held.key, []) if lods > held.lods else []  # levels of whole tiles cannot be removed
        for _, lod, payload in late:
            with suppress(DecodeError):
                state.add_layer(lod, payload)
        state = state.reduced(min(lods, state.lod + 1))
        taken = StoredLooks(index=-1, key=held.key, sphere=held.sphere, versions=Versions(state, self.mark))
        other._tiles[held.key] = other._replay[held.key] = taken

    def _looks_of(self, key: Key, lod: int, payload: memoryview) -> Key | None:
        """The looks that a tile of motion moves; None of other kinds."""
        return self._opener.looks_of(First(key, lod, payload)) if self._in_motion else None

    def _open_ahead(self, arrivals: Sequence[Arrival]) -> Ahead:
        """Open the new tiles among the arrivals together, except motion of looks that have not arrived."""
        firsts: dict[Key, First] = {}
        moving: dict[Key, tuple[First, Key]] = {}
        for arrival in arrivals:
            if not arrival.payloads or not self._opens(arrival.from_lod) or arrival.key in self._tiles:
                continue
            first = First(arrival.key, arrival.from_lod, arrival.payloads[0])
            looks = self._looks_of(first.key, first.lod, first.payload)
            if looks is None:
                firsts.setdefault(first.key, first)
            else:
                moving.setdefault(first.key, (first, looks))
        ahead = self._opened_together(firsts)
        on_looks = {key: (first, self._decoder_of(looks, ahead)) for key, (first, looks) in moving.items()}
        return ahead | self._opened_together(
            {key: replace(first, looks=looks) for key, (first, looks) in on_looks.items() if looks is not None}
        )

    def _opened_together(self, firsts: Mapping[Key, First]) -> Ahead:
        opened = self._opener.opened(list(firsts.values()))
        return {key: (first.payload, tile) for (key, first), tile in zip(firsts.items(), opened, strict=True)}

    def _decoder_of(self, looks: Key, ahead: Ahead) -> TileDecoder | None:
        """A tile of looks that is held or opened ``ahead``; None where there is none."""
        held = self._tiles.get(looks)
        if isinstance(held, StoredLooks):
            return held.versions.newest
        _, opened = ahead.get(looks, (None, None))
        return opened.state if isinstance(opened, OpenTile) else None

    def _opens(self, lod: int) -> bool:
        """Whether a payload of ``lod`` opens a new tile: it is a base layer or a whole tile."""
        return lod == 0 or not self._layered

    def _add(self, key: Key, layers: Layers, ahead: Ahead) -> None:
        """``ahead``: tiles that are opened already."""
        if key in self._tiles and self._tiles[key] is None:
            return
        held = self._tiles.get(key)
        if isinstance(held, StoredLooks) and held.replaced:  # useful when earlier frames are shown again
            self._keep_late(key, layers)
            return
        if held is None:
            if not layers or not self._opens(layers[0][0]) or self._waits(key, *layers[0]):
                self._wait(key, layers)
                return
            opened = self._taken(ahead, key, layers[0][1])
            if opened is None:
                opened = self._opened(key, *layers[0])
            if opened is None:
                self._tiles[key] = None
                return
            held = self._take(key, layers[0][1], opened, ahead)
            self._touched[key] = held
            layers = layers[1:] + self._waiting.take(key)
        for lod, payload in layers:
            if lod > 0 and self._add_layer(held, lod, payload):
                self._touched[key] = held

    @staticmethod
    def _taken(ahead: Ahead, key: Key, payload: memoryview) -> Opened | DecodeError | None:
        """The tile that ``payload`` opened ahead, if any. A waiting tile may have arrived a second time, damaged."""
        if key not in ahead or ahead[key][0] is not payload:
            return None
        return ahead.pop(key)[1]

    def _opened(self, key: Key, lod: int, payload: memoryview) -> Opened | DecodeError | None:
        """None where the looks that it moves are not kept."""
        looks, decoder = self._looks_of(key, lod, payload), None
        if looks is not None:
            decoder = self._decoder_of(looks, {})
            if decoder is None and self._tiles.get(looks) is None:
                return None
            if decoder is None:
                return DecodeError(f"{named(key)}: moves {named(looks)}, which holds no splats that move by then")
        return self._opener.opened([First(key, lod, payload, decoder)])[0]

    def _add_layer(self, held: StoredTile, lod: int, payload: memoryview) -> bool:
        versions = held.versions
        changed = False
        try:
            if versions is not None and lod > versions.newest.lod:
                changed = versions.writable(self.mark).add_layer(lod, payload)
        except DecodeError:  # error of this level, or of one that waited for it
            if isinstance(held, StoredMotion):
                self._drop_levels(held)
            raise
        if changed and versions is not None:
            versions.touch()
        if versions is not None and len(versions) > 1:
            with self._lock:
                self._several[held.key] = held
        if isinstance(held, StoredMotion) and 0 < lod < MOTION_LEVELS:
            self._keep_motion(held, lod, payload)
        return changed

    def _waits(self, key: Key, lod: int, payload: memoryview) -> bool:
        """Whether ``key`` moves looks that have not arrived. Raises :class:`DecodeError`."""
        looks = self._looks_of(key, lod, payload)
        if looks is None or looks in self._tiles:
            return False
        if not self._frames.start <= looks[0] <= key[0]:
            raise DecodeError(f"{named(key)}: moves {named(looks)}, which is not of its group of frames up to it")
        self._motions.wait(key, looks)
        return True

    def _wait(self, key: Key, layers: Layers) -> None:
        for gone in self._waiting.add(key, layers):
            self._motions.give_up(gone)
            self._dropped.append(InventoryEntry(*gone, 0))

    def _take(self, key: Key, payload: memoryview, tile: Opened | DecodeError, ahead: Ahead) -> StoredTile:
        """A new tile. Raises :class:`DecodeError`."""
        if isinstance(tile, DecodeError):
            raise tile
        if len(self._tiles) >= MAX_TILES_PER_GOF:
            raise DecodeError(f"{named(key)}: the group already has {MAX_TILES_PER_GOF} tiles")
        if isinstance(tile, OpenMotion):
            return self._take_motion(key, payload, tile)
        self.check_ids(tile.state.ids, named(key))
        if isinstance(tile, OpenUpdate):
            return self._take_update(StoredUpdate(key, Versions(tile.state, self.mark)))
        held = StoredLooks(index=-1, key=key, sphere=tile.sphere, versions=Versions(tile.state, self.mark))
        with self._lock:
            self._tiles[key] = held
        self._bring(self._motions.come(key), ahead)
        return held

    def _bring(self, waiting: list[Key], ahead: Ahead) -> None:
        """Looks have arrived: add the motion that waited for them. Errors are returned by the next :meth:`flush`."""
        for key in waiting:
            for layer in sorted(self._waiting.take(key), key=lambda layer: layer[0]):
                try:
                    self._add(key, [layer], ahead)
                except DecodeError as error:
                    self._errors.append(error)

    def _take_motion(self, key: Key, payload: memoryview, tile: OpenMotion) -> StoredMotion:
        state = tile.state
        looks = self._tiles.get(state.looks)
        if not self._in_motion or not isinstance(looks, StoredLooks) or looks.key[0] > key[0]:
            raise DecodeError(f"{named(key)}: moves {named(state.looks)}, which holds no splats that move by then")
        if len(state) != len(looks.versions.newest):
            had = f"{named(state.looks)}, which has {len(looks.versions.newest)}"
            raise DecodeError(f"{named(key)}: moves {len(state)} splats of {had}")
        held = StoredMotion(key, state.looks, Versions(state, self.mark), {})
        with self._lock:
            self._tiles[key] = held
            if (before := self._motions.add(held)) is not None:
                self._tiles[before.key] = None
        self._keep_motion(held, 0, payload)
        return held

    def _take_update(self, held: StoredUpdate) -> StoredUpdate:
        with self._lock:
            self._tiles[held.key] = held
            self._updated_splats += len(held.versions.newest)
            self._bound_kept()
        return held

    def check_ids(self, ids: Ids, what: str) -> None:
        """Raise :class:`DecodeError` for ids that the group does not have."""
        if len(ids) and (int(ids.min()) < 0 or int(ids.max()) >= self._capacity):
            raise DecodeError(f"{what}: id {int(ids.max())} is outside the group's capacity {self._capacity}")

    def _keep_late(self, key: Key, layers: Layers) -> None:
        with self._lock:
            late = self._late.setdefault(key, [])
            late.extend((self.mark, lod, self._opener.kept(payload)) for lod, payload in layers)
            self._late_bytes += sum(len(payload) for _, payload in layers)
            if self._late_bytes > MAX_LATE_BYTES and self._opener.bounded:
                self._stop_keeping()

    def _keep_motion(self, held: StoredMotion, level: int, payload: memoryview) -> None:
        with self._lock:
            if level not in held.payloads:
                held.payloads[level] = KeptPayload(self.mark, self._opener.kept(payload))
                self._motion_bytes += len(payload)
                self._bound_kept()

    def _drop_levels(self, held: StoredMotion) -> None:
        """Forget levels of motion that were not decoded; they do not count as held."""
        with self._lock:
            decoded = held.versions.newest.lod if held.versions is not None else 0
            for level in [level for level in held.payloads if level > decoded]:
                self._motion_bytes -= len(held.payloads.pop(level).data)

    @property
    def kept_splats(self) -> int:
        """Splats that are held for a replay alone; motion and updates count as the splats that take as much memory."""
        return self._kept_splats + self._updated_splats + self._motion_bytes // KEPT_SPLAT_BYTES

    def _bound_kept(self) -> None:
        if self._opener.bounded and self.keeps and self.kept_splats > MAX_KEPT_SPLATS:
            self._stop_keeping()

    # ---------------------------------------------------------------------------------------------------------- staging

    def stage_unless_decoding(self, horizon: int) -> None:
        """Dequantise tiles that were not flushed. Tiles of a frame are flushed before its end, so a batch that is being
        decoded misses nothing of it; only replays must wait.
        """
        wait = any(key[0] <= horizon for key in list(self._replay))
        if not self._decoding.acquire(blocking=wait):
            return
        try:
            self._stage(horizon, horizon)
        finally:
            self._decoding.release()

    def _stage(self, horizon: float, replayed: int) -> None:
        """Dequantise touched tiles of frames up to ``horizon``, and tiles to replay of frames up to ``replayed``.

        Errors are returned by the next :meth:`flush`.
        """
        self._reopen([k for k in self._replay if k[0] <= replayed])
        fresh = [make for held in self._take_touched(horizon).values() for make in to_stage(held)]
        for item in self._opener.run(staged, fresh):
            with self._lock:
                of = self._staged.setdefault(item.held.key, [])
                if of and of[-1].since == item.since:
                    of.pop()
                of.append(item)

    def _reopen(self, keys: list[Key]) -> None:
        """Mark tiles to replay as touched; only the motion in effect there is decoded again."""
        motions = []
        for key in keys:
            held = self._touched[key] = self._replay.pop(key)
            if isinstance(held, StoredMotion):
                if self._is_followed(held):
                    self._retire(held)
                elif held.versions is None:
                    motions.append(held)
        for held, versions in zip(motions, self._opener.run(self._decoded_again, motions), strict=True):
            if isinstance(versions, DecodeError):
                self._errors.append(versions)
            else:
                held.versions = versions

    def _decoded_again(self, held: StoredMotion) -> Versions[MotionDecoder] | DecodeError:
        looks = self._decoder_of(held.looks, {})
        if looks is None:
            return DecodeError(f"{named(held.key)}: moves {named(held.looks)}, which is not kept")
        return held.opened(self._opener, looks, self._floor)

    def _is_followed(self, held: StoredMotion) -> bool:
        """Whether a later chunk of the same looks has replaced it."""
        others = [other for other in self._motions.of(held.looks) if held.key[0] < other.key[0] <= self._horizon]
        return any(other.payloads[0].since < self._basis for other in others)

    def _take_touched(self, horizon: float) -> dict[Key, StoredTile]:
        touched: dict[Key, StoredTile] = {}
        for key in [k for k in self._touched if k[0] <= horizon]:
            held = self._touched.pop(key)
            try:
                if isinstance(held, StoredLooks):
                    self.check_ids(held.versions.newest.ids, named(key))
                touched[key] = held
            except DecodeError as error:
                self._errors.append(error)
        return touched

    # ----------------------------------------------------------------------------------------- display (display thread)

    def due(self, horizon: int, basis: float) -> list[Staged]:
        """Take staged tiles of frames up to ``horizon`` that arrived before mark ``basis``, in order."""
        with self._lock:
            self._horizon, self._basis = max(self._horizon, horizon), basis
            due = []
            for key in sorted(key for key in self._staged if key[0] <= horizon):
                come = [item for item in self._staged[key] if item.since < basis]
                if come:
                    due.append(come[-1])
                    del self._staged[key][: len(come)]
                if not self._staged[key]:
                    del self._staged[key]
            self._trim(basis)
            return due

    def _trim(self, basis: float) -> None:
        """From now on only later marks are requested; none is requested while everything is shown."""
        if basis == math.inf:
            return
        self._floor = max(self._floor, basis)
        for key, held in list(self._several.items()):
            if held.versions is not None:
                held.versions.trim(self._floor)
            if held.versions is None or len(held.versions) == 1:
                del self._several[key]

    def rewind(self, horizon: int, basis: float) -> list[Key]:
        """Queue all held tiles for display again in order, first those up to ``horizon`` that arrived before mark
        ``basis``. Returns the looks that move.
        """
        with self._decoding, self._lock:
            self._horizon, self._basis = horizon, basis
            self._trim(basis)
            for key, held in self._tiles.items():
                if held is None:
                    continue
                self._replay[key], held.shown_lod = held, -1
                if isinstance(held, StoredLooks):
                    held.owned, held.replaced = 0, False
                    self._take_late(held)
                if held.versions is not None:
                    held.versions.again()
            self._staged.clear()
            self._touched.clear()
            self._kept_splats = self._late_bytes = 0
            return self._motions.looks()

    def _take_late(self, held: StoredLooks) -> None:
        for mark, lod, payload in self._late.pop(held.key, []):
            with suppress(DecodeError):  # a damaged level: the tile keeps its quality
                held.versions.writable(mark).add_layer(lod, payload)
                self._several[held.key] = held

    def replaced(self, held: StoredLooks) -> list[StoredMotion]:
        """A tile is no longer shown: keep it for a replay while there is room. Returns its expired motion."""
        with self._lock:
            self._staged.pop(held.key, None)
            held.replaced = True
            past = self._motions.of(held.key)
            for motion in past:
                self._retire(motion)
            self._kept_splats += len(held.versions.newest)
            if not self.keeps:
                self._tiles[held.key] = None
            self._bound_kept()
            return past

    def past(self, chunks: list[tuple[Key, int]]) -> list[StoredMotion]:
        """Expire replaced chunks of motion, each named by its looks and first frame; returns their tiles."""
        with self._lock:
            past = [held for looks, start in chunks if (held := self._motions.at(looks, start)) is not None]
            for held in past:
                self._retire(held)
            return past

    def forget(self, update: StoredUpdate) -> None:
        """An update is no longer shown, and not kept."""
        with self._lock:
            self._give_up(update)

    def chunk(self, looks: Key, start: int) -> StoredMotion | None:
        """The motion of tile ``looks`` from media frame ``start`` on, if it has arrived."""
        with self._lock:
            return self._motions.at(looks, start)

    def updates(self) -> list[StoredUpdate]:
        """Updates that have been shown."""
        with self._lock:
            return [held for held in self._tiles.values() if isinstance(held, StoredUpdate) and held.shown_lod >= 0]

    def looks(self, key: Key) -> StoredLooks | None:
        """The tile of looks ``key``."""
        held = self._tiles.get(key)
        return held if isinstance(held, StoredLooks) else None

    def held(self) -> list[InventoryEntry]:
        """Held tiles of all kinds: those shown, waiting to be shown, or kept for a replay."""
        with self._decoding, self._lock:
            return [InventoryEntry(*key, h.lods) for key, h in self._tiles.items() if h is not None]

    def _retire(self, held: StoredMotion) -> None:
        """A tile of motion has expired, or its looks are gone: keep only its payloads."""
        held.versions = None
        self._staged.pop(held.key, None)
        if not self.keeps:
            self._give_up(held)

    def _give_up(self, held: StoredTile) -> None:
        self._tiles[held.key] = None
        if isinstance(held, StoredMotion):
            self._motions.discard(held)

    def _stop_keeping(self) -> None:
        self.keeps = False
        self._late.clear()
        for held in [h for h in self._tiles.values() if h is not None]:
            past = isinstance(held, StoredMotion) and held.versions is None
            if past or (isinstance(held, StoredLooks) and held.replaced):
                self._give_up(held)
