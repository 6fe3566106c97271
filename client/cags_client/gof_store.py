"""What the client holds of one group of frames: tiles at any depth, in any order of arrival.

Tiles are decoded when they arrive (off the display path, several at a time) and *staged*; :meth:`GofStore.commit` makes
them visible, all of a frame's at once, when that frame is shown (:mod:`cags_client.merged` has the rules by which they
become one array of splats). Each group of frames has ids, and a store, of its own. Showing an earlier frame of the
group replays what is held, so a loop or a jump back asks the network for nothing.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_client.merged import MergedSplats
from cags_client.opening import Arrival, OpenTile, TileOpener
from cags_client.past import SplatPast
from cags_client.shown import Held, Shown
from cags_client.waiting import Key, WaitingLayers
from cags_common.bundle.manifest import Manifest
from cags_common.codecs import WHOLE_TILES_CODEC
from cags_common.errors import DecodeError
from cags_common.splats import Ids, Splats
from cags_protocol.messages import HeldTile

MAX_LATE_BYTES = 8 << 20
"""Bound on layers of replaced tiles that are kept for showing earlier frames again; past it none are."""

MAX_TILES_PER_GOF = 1 << 17
"""Bound on the tiles of one group of frames."""

MAX_KEPT_SPLATS = 1 << 22
"""Splats of replaced tiles that are kept for showing earlier frames again (about 40 bytes each); past it none are."""

REPLAY_AHEAD = 8
"""Frames ahead of the display whose kept tiles are dequantised off the display path."""


@dataclass(eq=False)
class _Staged:
    held: Held
    ids: Ids
    splats: Splats
    lod: int


@dataclass(frozen=True, slots=True)
class Committed:
    """What became visible: the rows that changed [M], all of them where the group of frames is new."""

    gof: int
    rows: NDArray[np.intp]
    fresh: bool
    missed: bool
    """The end of this frame was not there: something older is shown."""


class GofStore:
    """One group of frames. One thread may add and flush while another commits, which never waits for a decoder."""

    def __init__(self, manifest: Manifest, gof: int, opener: TileOpener) -> None:
        self.capacity = manifest.capacity[gof]
        self.past = SplatPast(manifest.gof_starts[gof])
        """What the splats on display were a few frames ago."""
        self._opener, self._top_lod = opener, manifest.lods - 1
        self._layered = manifest.codec != WHOLE_TILES_CODEC
        self._merged = MergedSplats(self.capacity, manifest.sh_degree, self.past, self._replaced)
        self._tiles: dict[Key, Held | None] = {}  # None: every splat of it has been replaced, and it is not kept
        self._late: dict[Key, list[tuple[int, bytes]]] = {}  # layers of tiles that are kept, though replaced
        self._replay: dict[Key, Held] = {}
        self._kept_splats = self._late_bytes = 0
        self._shown_frame = -1
        self.keeps = True
        """Whether earlier frames of the group can be shown again from what is held."""
        self._rewound = False
        self._waiting = WaitingLayers()
        self._dropped: list[HeldTile] = []
        self._touched: dict[Key, Held] = {}
        self._errors: list[DecodeError] = []
        self._staged: dict[Key, _Staged] = {}
        self._ends: dict[int, Ids] = {}  # not yet shown
        self._ended: dict[int, Ids] = {}
        self._lock = threading.Lock()
        self._decoding = threading.Lock()

    @property
    def splats(self) -> Splats:
        """Those on display; rows are splat ids. They change with :meth:`commit`."""
        return self._merged.splats

    @property
    def improved(self) -> int:
        """Times that layers made splats on display better without a change of what they show."""
        return self._merged.improved

    # ------------------------------------------------------------------------------------------ arrival (decode thread)

    def add(self, arrivals: Sequence[Arrival]) -> list[DecodeError]:
        """Decode tiles' layers; what is wrong with those that are left out. Duplicates change nothing.

        Damaged payloads and ids beyond the group's capacity are left out; what was held stays.
        """
        errors = []
        with self._decoding:
            ahead = self._open_ahead(arrivals)
            for at, arrival in enumerate(arrivals):
                try:
                    self._add(arrival, ahead.get(at))
                except DecodeError as error:
                    errors.append(error)
        return errors

    def flush(self) -> list[DecodeError]:
        """Dequantise the tiles that :meth:`add` touched, each once, and stage them; what is wrong with those that have
        grown ids beyond the capacity, and are left out.
        """
        with self._decoding:
            self._stage(None, self._shown_frame + REPLAY_AHEAD)
            errors, self._errors = self._errors, []
        return errors

    def take_dropped(self) -> list[HeldTile]:
        """What had come and was given up since the last call, for want of memory: the server may send it again."""
        with self._decoding:
            dropped, self._dropped = self._dropped, []
        return dropped

    def _stage(self, horizon: int | None, replayed: int) -> None:
        """Dequantise touched tiles of frames up to ``horizon``, and those to be replayed of frames up to ``replayed``.

        Errors wait for the next :meth:`flush`.
        """
        for key in [k for k in self._replay if k[0] <= replayed]:
            self._touched[key] = self._replay.pop(key)
        touched = self._take_touched(horizon)
        splats = self._opener.dequantise([held.tile.state for held in touched.values()])
        with self._lock:
            for (key, held), values in zip(touched.items(), splats, strict=True):
                self._staged[key] = _Staged(held, held.tile.state.ids, values, held.tile.state.lod)

    def _take_touched(self, horizon: int | None) -> dict[Key, Held]:
        touched: dict[Key, Held] = {}
        for key in [k for k in self._touched if horizon is None or k[0] <= horizon]:
            held = self._touched.pop(key)
            try:
                self._check_ids(held.tile.state.ids, f"tile {key[1]} of frame {key[0]}")
                touched[key] = held
            except DecodeError as error:
                self._errors.append(error)
        return touched

    def _open_ahead(self, arrivals: Sequence[Arrival]) -> dict[int, OpenTile | DecodeError]:
        """Arrivals' places -> the new tiles that they bring."""
        first: dict[Key, int] = {}
        for at, arrival in enumerate(arrivals):
            if self._opens(arrival) and arrival.key not in self._tiles:
                first.setdefault(arrival.key, at)
        places = list(first.values())
        return dict(zip(places, self._opener.open([arrivals[at].payloads[0] for at in places]), strict=True))

    def _opens(self, arrival: Arrival) -> bool:
        """Whether a tile of which nothing is held begins with ``arrival``: with its base, or with the whole of it."""
        return bool(arrival.payloads) and (arrival.from_lod == 0 or not self._layered)

    def _add(self, arrival: Arrival, ahead: OpenTile | DecodeError | None) -> None:
        key = arrival.key
        if key in self._tiles and self._tiles[key] is None:
            return
        held = self._tiles.get(key)
        layers = list(enumerate(arrival.payloads, start=arrival.from_lod))
        if held is not None and held.replaced:  # of use once earlier frames are shown again
            self._keep_late(key, layers)
            return
        changed = False
        if held is None:
            if not self._opens(arrival):
                self._dropped += [HeldTile(*gone, 0) for gone in self._waiting.add(key, layers)]
                return
            held = self._take(key, ahead or self._opener.open([layers[0][1]])[0])
            layers = layers[1:] + self._waiting.take(key)
            changed = True
        try:
            for lod, payload in layers:
                changed |= lod > 0 and held.tile.state.add_layer(lod, payload)
        finally:
            if changed:
                self._touched[key] = held

    def end(self, frame: int, removed: Ids) -> None:
        """Nothing more is planned for ``frame``; ``removed`` ids end there. Raises :class:`DecodeError`."""
        self._check_ids(removed, f"removed ids of frame {frame}")
        with self._lock:
            if frame not in self._ended:
                self._ends[frame] = self._ended[frame] = removed

    def _take(self, key: Key, tile: OpenTile | DecodeError) -> Held:
        if isinstance(tile, DecodeError):
            raise tile
        if len(self._merged.tiles) >= MAX_TILES_PER_GOF:
            raise DecodeError(f"tile {key[1]} of frame {key[0]}: the group already has {MAX_TILES_PER_GOF} tiles")
        self._check_ids(tile.state.ids, f"tile {key[1]} of frame {key[0]}")
        held = Held(len(self._merged.tiles), key, tile)
        with self._lock:
            self._merged.tiles.append(held)
            self._tiles[key] = held
        return held

    def _check_ids(self, ids: Ids, what: str) -> None:
        if len(ids) and (int(ids.min()) < 0 or int(ids.max()) >= self.capacity):
            raise DecodeError(f"{what}: id {int(ids.max())} is outside the group's capacity {self.capacity}")

    def _keep_late(self, key: Key, layers: list[tuple[int, memoryview]]) -> None:
        with self._lock:
            self._late.setdefault(key, []).extend((lod, bytes(payload)) for lod, payload in layers)
            self._late_bytes += sum(len(payload) for _, payload in layers)
            if self._late_bytes > MAX_LATE_BYTES:
                self._stop_keeping()

    # ----------------------------------------------------------------------------------------- display (display thread)

    def commit(self, frame: int) -> tuple[NDArray[np.intp], bool]:
        """Show what has come for frames up to ``frame``: the rows that changed, and whether ``frame`` is whole."""
        if frame < self._shown_frame:
            self._rewind()
            self.past.restart(frame)
        self._shown_frame = frame
        self.past.advance(frame)
        with self._lock:
            horizon = max((f for f in self._ended if f <= frame), default=-1)
        self._stage_unless_decoding(horizon)
        updates, ends, whole = self._due(frame, horizon)
        touched = np.zeros(self.capacity, dtype=bool)
        if self._rewound:
            touched[:], self._rewound = True, False
        for f, ids in ends:
            touched[self._merged.remove(f, ids)] = True
        for staged in updates:
            touched[self._merged.write(staged.held, staged.lod, staged.ids, staged.splats)] = True
        return np.nonzero(touched)[0], whole

    def _stage_unless_decoding(self, horizon: int) -> None:
        """Dequantise what nobody flushed. While a batch is being decoded nothing of a frame that has ended is missing:
        its tiles are flushed before its end. Only what is replayed must be waited for.
        """
        wait = any(key[0] <= horizon for key in list(self._replay))
        if not self._decoding.acquire(blocking=wait):
            return
        try:
            self._stage(horizon, horizon)
        finally:
            self._decoding.release()

    def _due(self, frame: int, horizon: int) -> tuple[list[_Staged], list[tuple[int, Ids]], bool]:
        """Staged tiles and removals of frames up to ``horizon``, in order, and whether ``frame`` has ended."""
        with self._lock:
            keys = sorted(key for key in self._staged if key[0] <= horizon)
            frames = sorted(f for f in self._ends if f <= horizon)
            updates = [self._staged.pop(key) for key in keys]
            return updates, [(f, self._ends.pop(f)) for f in frames], frame in self._ended

    def _rewind(self) -> None:
        """Back to an empty picture; everything held waits to be shown again, in order."""
        with self._decoding, self._lock:
            self._merged.clear()
            for key, held in self._tiles.items():
                if held is not None:
                    held.owned, held.shown_lod, held.replaced = 0, -1, False
                    self._replay[key] = held
                    for lod, payload in self._late.pop(key, []):
                        with suppress(DecodeError):  # damaged on the way: the tile stays as good as it was
                            held.tile.state.add_layer(lod, payload)
            self._staged.clear()
            self._touched.clear()
            self._ends = dict(self._ended)
            self._kept_splats = self._late_bytes = 0
            self._rewound = True

    @property
    def shown_frame(self) -> int:
        """The frame on display; -1 before any."""
        return self._shown_frame

    @property
    def newest(self) -> int:
        """The newest frame that has come whole; -1 before any."""
        with self._lock:
            return max(self._ended, default=-1)

    def holds(self, frame: int) -> bool:
        """Whether ``frame`` can be shown whole at once."""
        with self._lock:
            return self.keeps and frame in self._ended

    def _replaced(self, held: Held) -> None:
        """Nothing of a tile is shown any more: it is kept for a replay, as long as there is room."""
        if held.replaced:
            return
        with self._lock:
            self._staged.pop(held.key, None)
            held.replaced = True
            self._kept_splats += len(held.tile.state)
            if not self.keeps:
                self._tiles[held.key] = None
            elif self._kept_splats > MAX_KEPT_SPLATS:
                self._stop_keeping()

    def _stop_keeping(self) -> None:
        self.keeps = False
        self._late.clear()
        for key in [k for k, h in self._tiles.items() if h is not None and h.replaced]:
            self._tiles[key] = None

    # ---------------------------------------------------------------------------------------------------------- figures

    @property
    def shown(self) -> Shown:
        """What is on display."""
        with self._lock:
            return self._merged.shown

    def held(self) -> list[HeldTile]:
        """The tiles of which splats are shown, wait to be, or are kept for a replay."""
        with self._decoding, self._lock:
            return [HeldTile(*key, h.tile.state.lod + 1) for key, h in self._tiles.items() if h is not None]

    @property
    def full(self) -> bool:
        """Whether everything shown is at its highest LoD, so that nothing is left to restore."""
        return self.shown.full(self._top_lod)
