"""What has come of one group of frames: tiles of any kind at any depth, in any order of arrival.

Tiles are decoded when they arrive, off the display path and several at a time, and then *staged*: dequantised, for the
display to take. What is replaced or past stays for showing earlier frames again, within bounds.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import suppress
from typing import TypeAlias

from cags_client.motions import AnyHeld, HeldMotion, HeldUpdate, Motions, Staged, looks_of, named, reopened, staged_from
from cags_client.opening import Arrival, Opened, TileOpener
from cags_client.shown import Held
from cags_client.waiting import Key, WaitingLayers
from cags_common.codecs import MotionTile
from cags_common.errors import DecodeError
from cags_common.motion.chunk import LEVELS as MOTION_LEVELS
from cags_common.motion.chunk import VERSION as MOTION_VERSION
from cags_common.splats import Ids
from cags_common.updates import UpdateState
from cags_protocol.messages import HeldTile

MAX_LATE_BYTES = 8 << 20
"""Bound on layers of replaced tiles that are kept for showing earlier frames again; past it none are."""

MAX_TILES_PER_GOF = 1 << 17
"""Bound on the tiles of one group of frames."""

MAX_KEPT_SPLATS = 1 << 22
"""Splats of replaced tiles and of updates that are kept for showing earlier frames again; past it none are."""

KEPT_SPLAT_BYTES = 40
"""What a kept splat takes; payloads of motion count as so many splats."""

Layers: TypeAlias = list[tuple[int, memoryview]]


class GofTiles:
    """Tiles of one group of frames. One thread may add and flush while another takes what is staged."""

    def __init__(
        self, frames: range, capacity: int, opener: TileOpener, *, layered: bool = True, in_motion: bool = False
    ) -> None:
        """Of media ``frames`` and ids below ``capacity``; ``layered`` unless any payload is a whole tile, ``in_motion``
        where the bundle has motion.
        """
        self._frames, self._capacity, self._opener = frames, capacity, opener
        self._layered, self._in_motion = layered, in_motion
        self.keeps = True
        """Whether earlier frames of the group can be shown again from what is held."""
        self._tiles: dict[Key, AnyHeld | None] = {}  # None: nothing of it is shown any more, and it is not kept
        self._motions = Motions()
        self._late: dict[Key, list[tuple[int, bytes]]] = {}  # layers of tiles that are kept, though replaced
        self._replay: dict[Key, AnyHeld] = {}
        self._kept_splats = self._late_bytes = self._motion_bytes = self._updated_splats = 0
        self._waiting = WaitingLayers()
        self._dropped: list[HeldTile] = []
        self._touched: dict[Key, AnyHeld] = {}
        self._errors: list[DecodeError] = []
        self._staged: dict[Key, Staged] = {}
        self._lock = threading.Lock()
        self._decoding = threading.Lock()

    # ------------------------------------------------------------------------------------------ arrival (decode thread)

    def add(self, arrivals: Sequence[Arrival]) -> list[DecodeError]:
        """Decode tiles' layers; what is wrong with those that are left out. Duplicates change nothing.

        Damaged payloads, ids beyond the group's capacity and motion that does not fit its looks are left out; what was
        held stays.
        """
        errors = []
        with self._decoding:
            ahead = self._open_ahead(arrivals)
            for at in sorted(range(len(arrivals)), key=lambda at: looks_of(self._first(arrivals[at])) is not None):
                arrival = arrivals[at]
                try:
                    self._add(arrival.key, list(enumerate(arrival.payloads, arrival.from_lod)), ahead.get(at))
                except DecodeError as error:
                    errors.append(error)
        return errors

    def flush(self, shown: int, replayed: int) -> list[DecodeError]:
        """Dequantise the tiles that :meth:`add` touched, each once, and stage them; what is wrong with those that have
        grown ids beyond the capacity, or waited for looks that they do not fit, and are left out.

        ``shown`` is the frame on display; of what is to be shown again only frames up to ``replayed`` are.
        """
        with self._decoding:
            self._stage(None, shown, replayed)
            errors, self._errors = self._errors, []
        return errors

    def take_dropped(self) -> list[HeldTile]:
        """What had come and was given up since the last call, for want of memory: the server may send it again."""
        with self._decoding:
            dropped, self._dropped = self._dropped, []
        return dropped

    def _first(self, arrival: Arrival) -> memoryview | None:
        """LoD 0 of a tile of motion, else None."""
        if not self._in_motion or arrival.from_lod or not arrival.payloads:
            return None
        payload = arrival.payloads[0]
        return payload if len(payload) and payload[0] == MOTION_VERSION else None

    def _open_ahead(self, arrivals: Sequence[Arrival]) -> dict[int, Opened | DecodeError]:
        """Arrivals' places -> the new tiles that they bring; not motion of looks that are yet to come."""
        coming = {arrival.key for arrival in arrivals if arrival.from_lod == 0}
        first: dict[Key, int] = {}
        for at, arrival in enumerate(arrivals):
            if not arrival.payloads or not self._opens(arrival.from_lod) or arrival.key in self._tiles:
                continue
            looks = looks_of(self._first(arrival))
            if looks is None or looks in self._tiles or looks in coming:
                first.setdefault(arrival.key, at)
        places = list(first.values())
        return dict(zip(places, self._opener.open([arrivals[at].payloads[0] for at in places]), strict=True))

    def _opens(self, lod: int) -> bool:
        """Whether a payload of ``lod`` opens a tile of which nothing is held: its base, or the whole of it."""
        return lod == 0 or not self._layered

    def _add(self, key: Key, layers: Layers, ahead: Opened | DecodeError | None) -> None:
        if key in self._tiles and self._tiles[key] is None:
            return
        held = self._tiles.get(key)
        if isinstance(held, Held) and held.replaced:  # of use once earlier frames are shown again
            self._keep_late(key, layers)
            return
        changed = held is None
        if held is None:
            if not layers or not self._opens(layers[0][0]) or self._waits(key, layers[0][1]):
                self._wait(key, layers)
                return
            held = self._take(key, layers[0][1], ahead or self._opener.open([layers[0][1]])[0])
            if held is None:
                return
            layers = layers[1:] + self._waiting.take(key)
        try:
            for lod, payload in layers:
                changed |= lod > 0 and self._add_layer(held, lod, payload)
        finally:
            if changed:
                self._touched[key] = held

    def _add_layer(self, held: AnyHeld, lod: int, payload: memoryview) -> bool:
        if isinstance(held, Held):
            return held.tile.state.add_layer(lod, payload)
        if isinstance(held, HeldUpdate):
            return held.state.add_layer(lod, payload)
        state = held.state
        try:
            changed = state is not None and state.add_layer(lod, payload)
        except DecodeError:  # of this level, or of one that had to wait for it
            self._drop_levels(held)
            raise
        if 0 < lod < MOTION_LEVELS:
            self._keep_motion(held, lod, payload)
        return changed

    def _waits(self, key: Key, payload: memoryview) -> bool:
        """Whether LoD 0 of ``key`` moves looks that have not come. Raises :class:`DecodeError`."""
        looks = looks_of(self._first(Arrival(*key, 0, [payload])))
        if looks is None or looks in self._tiles:
            return False
        if not self._frames.start <= looks[0] <= key[0]:
            raise DecodeError(f"{named(key)}: moves {named(looks)}, which is not of its group of frames up to it")
        self._motions.wait(key, looks)
        return True

    def _wait(self, key: Key, layers: Layers) -> None:
        for gone in self._waiting.add(key, layers):
            self._motions.give_up(gone)
            self._dropped.append(HeldTile(*gone, 0))

    def _take(self, key: Key, payload: memoryview, tile: Opened | DecodeError) -> AnyHeld | None:
        """A tile that is new; None where what it moves is not kept. Raises :class:`DecodeError`."""
        if isinstance(tile, DecodeError):
            raise tile
        if len(self._tiles) >= MAX_TILES_PER_GOF:
            raise DecodeError(f"{named(key)}: the group already has {MAX_TILES_PER_GOF} tiles")
        if isinstance(tile, MotionTile):
            return self._take_motion(key, payload, tile)
        if isinstance(tile, UpdateState):
            self.check_ids(tile.ids, named(key))
            return self._take_update(HeldUpdate(key, tile))
        self.check_ids(tile.state.ids, named(key))
        held = Held(index=-1, key=key, steps=tile.state.steps, tile=tile)
        with self._lock:
            self._tiles[key] = held
        self._bring(self._motions.come(key))
        return held

    def _bring(self, waiting: list[Key]) -> None:
        """Looks have come: take the motion that waited for them. Errors wait for the next :meth:`flush`."""
        for key in waiting:
            for layer in sorted(self._waiting.take(key), key=lambda layer: layer[0]):
                try:
                    self._add(key, [layer], None)
                except DecodeError as error:
                    self._errors.append(error)

    def _take_motion(self, key: Key, payload: memoryview, tile: MotionTile) -> HeldMotion | None:
        looks = self._tiles.get(tile.looks)
        if looks is None and tile.looks in self._tiles:
            self._tiles[key] = None
            return None
        if not self._in_motion or not isinstance(looks, Held) or looks.key[0] > key[0]:
            raise DecodeError(f"{named(key)}: moves {named(tile.looks)}, which holds no splats that move by then")
        if len(tile) != len(looks.tile.state):
            had = f"{named(tile.looks)}, which has {len(looks.tile.state)}"
            raise DecodeError(f"{named(key)}: moves {len(tile)} splats of {had}")
        held = HeldMotion(key, tile.looks, tile, {})
        with self._lock:
            self._tiles[key] = held
            if (before := self._motions.add(held)) is not None:
                self._tiles[before.key] = None
        self._keep_motion(held, 0, payload)
        return held

    def _take_update(self, held: HeldUpdate) -> HeldUpdate:
        with self._lock:
            self._tiles[held.key] = held
            self._updated_splats += len(held.state)
            self._bound_kept()
        return held

    def check_ids(self, ids: Ids, what: str) -> None:
        """Raise :class:`DecodeError` for ids that the group does not have."""
        if len(ids) and (int(ids.min()) < 0 or int(ids.max()) >= self._capacity):
            raise DecodeError(f"{what}: id {int(ids.max())} is outside the group's capacity {self._capacity}")

    def _keep_late(self, key: Key, layers: Layers) -> None:
        with self._lock:
            self._late.setdefault(key, []).extend((lod, bytes(payload)) for lod, payload in layers)
            self._late_bytes += sum(len(payload) for _, payload in layers)
            if self._late_bytes > MAX_LATE_BYTES:
                self._stop_keeping()

    def _keep_motion(self, held: HeldMotion, level: int, payload: memoryview) -> None:
        with self._lock:
            if level not in held.payloads:
                held.payloads[level] = bytes(payload)
                self._motion_bytes += len(payload)
                self._bound_kept()

    def _drop_levels(self, held: HeldMotion) -> None:
        """Of a tile of motion only what is decoded counts as held."""
        with self._lock:
            decoded = held.state.lod if held.state is not None else 0
            for level in [level for level in held.payloads if level > decoded]:
                self._motion_bytes -= len(held.payloads.pop(level))

    def _bound_kept(self) -> None:
        besides = self._updated_splats + self._motion_bytes // KEPT_SPLAT_BYTES
        if self.keeps and self._kept_splats + besides > MAX_KEPT_SPLATS:
            self._stop_keeping()

    # ---------------------------------------------------------------------------------------------------------- staging

    def stage_unless_decoding(self, horizon: int) -> None:
        """Dequantise what nobody flushed. While a batch is being decoded nothing of a frame that has ended is missing:
        its tiles are flushed before its end. Only what is replayed must be waited for.
        """
        wait = any(key[0] <= horizon for key in list(self._replay))
        if not self._decoding.acquire(blocking=wait):
            return
        try:
            self._stage(horizon, horizon, horizon)
        finally:
            self._decoding.release()

    def _stage(self, horizon: int | None, shown: int, replayed: int) -> None:
        """Dequantise touched tiles of frames up to ``horizon``, and those to be replayed of frames up to ``replayed``.

        Errors wait for the next :meth:`flush`.
        """
        self._reopen([k for k in self._replay if k[0] <= replayed], shown)
        touched = self._take_touched(horizon)
        staged = self._opener.run(staged_from, list(touched.values()))
        with self._lock:
            self._staged |= {item.held.key: item for item in staged if item is not None}

    def _reopen(self, keys: list[Key], horizon: int) -> None:
        """Touch what is to be replayed; of the motion up to ``horizon`` only what counts there is decoded again."""
        motions = []
        for key in keys:
            held = self._touched[key] = self._replay.pop(key)
            if isinstance(held, HeldMotion):
                later = any(key[0] < other.key[0] <= horizon for other in self._motions.of(held.looks))
                if later:
                    self._retire(held)
                elif held.state is None:
                    motions.append(held)
        for held, state in zip(motions, self._opener.run(reopened, motions), strict=True):
            if isinstance(state, DecodeError):
                self._errors.append(state)
            held.state = state if isinstance(state, MotionTile) else None

    def _take_touched(self, horizon: int | None) -> dict[Key, AnyHeld]:
        touched: dict[Key, AnyHeld] = {}
        for key in [k for k in self._touched if horizon is None or k[0] <= horizon]:
            held = self._touched.pop(key)
            try:
                if isinstance(held, Held):
                    self.check_ids(held.tile.state.ids, named(key))
                touched[key] = held
            except DecodeError as error:
                self._errors.append(error)
        return touched

    # ----------------------------------------------------------------------------------------- display (display thread)

    def due(self, horizon: int) -> list[Staged]:
        """Take what is staged of frames up to ``horizon``, in order."""
        with self._lock:
            return [self._staged.pop(key) for key in sorted(key for key in self._staged if key[0] <= horizon)]

    def rewind(self) -> list[Key]:
        """Everything held waits to be shown again, in order; the looks that move."""
        with self._decoding, self._lock:
            for key, held in self._tiles.items():
                if held is None:
                    continue
                self._replay[key], held.shown_lod = held, -1
                if isinstance(held, Held):
                    held.owned, held.replaced = 0, False
                    for lod, payload in self._late.pop(key, []):
                        with suppress(DecodeError):  # damaged on the way: the tile stays as good as it was
                            held.tile.state.add_layer(lod, payload)
            self._staged.clear()
            self._touched.clear()
            self._kept_splats = self._late_bytes = 0
            return self._motions.looks()

    def replaced(self, held: Held) -> list[HeldMotion]:
        """Nothing of a tile is shown any more: it is kept for a replay while there is room. Its motion, now past."""
        with self._lock:
            self._staged.pop(held.key, None)
            held.replaced = True
            past = self._motions.of(held.key)
            for motion in past:
                self._retire(motion)
            self._kept_splats += len(held.tile.state)
            if not self.keeps:
                self._tiles[held.key] = None
            self._bound_kept()
            return past

    def past(self, chunks: list[tuple[Key, int]]) -> list[HeldMotion]:
        """Later chunks of motion have followed these, each named by its looks and first frame: the tiles."""
        with self._lock:
            past = [held for looks, start in chunks if (held := self._motions.at(looks, start)) is not None]
            for held in past:
                self._retire(held)
            return past

    def forget(self, update: HeldUpdate) -> None:
        """Nothing of an update is shown any more, and nothing is kept."""
        with self._lock:
            self._give_up(update)

    def updates(self) -> list[HeldUpdate]:
        """Those that have been shown."""
        with self._lock:
            return [held for held in self._tiles.values() if isinstance(held, HeldUpdate) and held.shown_lod >= 0]

    def looks(self, key: Key) -> Held | None:
        """The tile of looks ``key``."""
        held = self._tiles.get(key)
        return held if isinstance(held, Held) else None

    def held(self) -> list[HeldTile]:
        """The tiles of which splats are shown, wait to be, or are kept for a replay; motion and updates like looks."""
        with self._decoding, self._lock:
            return [HeldTile(*key, h.lods) for key, h in self._tiles.items() if h is not None]

    def _retire(self, held: HeldMotion) -> None:
        """A tile of motion is past, or nothing is left of what it moves: only its payloads stay."""
        held.state = None
        self._staged.pop(held.key, None)
        if not self.keeps:
            self._give_up(held)

    def _give_up(self, held: AnyHeld) -> None:
        self._tiles[held.key] = None
        if isinstance(held, HeldMotion):
            self._motions.discard(held)

    def _stop_keeping(self) -> None:
        self.keeps = False
        self._late.clear()
        for held in [h for h in self._tiles.values() if h is not None]:
            if held.replaced if isinstance(held, Held) else isinstance(held, HeldMotion) and held.state is None:
                self._give_up(held)
