"""What the client holds of the scene: tiles at any depth, merged into one array of splats a group of frames.

Tiles are decoded when they arrive (off the display path) and *staged*; :meth:`TileStore.commit` makes them visible,
all of a frame's at once, when that frame is shown. The rules, whatever the order of arrival:

- the newest source frame wins, splat by splat (a tile of a later frame holds whole splats);
- an enhancement layer changes only the splats that its own tile still owns;
- a removal at frame f ends splats of source frames before f, and keeps late tiles of those from bringing them back;
- each group of frames has its own ids; the old group is dropped when the first frame of the next is shown;
- showing an earlier frame of the group replays what is held, so a loop or a jump back asks the network for nothing.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle.manifest import Manifest
from cags_common.codecs import TileCodec, TileDecoder
from cags_common.errors import DecodeError
from cags_common.geometry import F32, Camera
from cags_common.splats import SH_REST_OF_DEGREE, Ids, Splats

ABSENT_LOGIT = np.float32(-30.0)
"""Opacity logit of a row without a splat: drawn opacity 1e-13, which every rasteriser culls."""

MAX_WAITING_BYTES = 8 << 20
"""Bound on layers that wait for their tile's base, a group of frames."""

MAX_TILES_PER_GOF = 1 << 17
"""Bound on the tiles of one group of frames."""

MAX_KEPT_SPLATS = 1 << 22
"""Splats of replaced tiles that are kept for showing earlier frames again (about 40 bytes each); past it none are."""

REPLAY_AHEAD = 8
"""Frames ahead of the display whose kept tiles are dequantised off the display path."""

Key = tuple[int, int]
"""Source frame and tile."""


@dataclass(eq=False)
class _Held:
    """One tile: what is decoded of it, and how many rows it still owns."""

    index: int
    key: Key
    state: TileDecoder
    centre: F32  # [3] of its means
    radius: float
    owned: int = 0
    shown_lod: int = -1
    replaced: bool = False

    @property
    def frame(self) -> int:
        """Source frame."""
        return self.key[0]


@dataclass(eq=False)
class _Staged:
    held: _Held
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


@dataclass(eq=False)
class GofStore:
    """The splats of one group of frames. Rows are splat ids. Decoding and committing may run in two threads."""

    capacity: int
    sh_degree: int
    codec: TileCodec
    manifest: Manifest
    splats: Splats = field(init=False)

    def __post_init__(self) -> None:
        n, rest = self.capacity, SH_REST_OF_DEGREE[self.sh_degree]
        quats = np.zeros((n, 4), np.float32)
        quats[:, 0] = 1.0
        zeros = np.zeros((n, 3), np.float32)
        absent = np.full(n, ABSENT_LOGIT)
        self.splats = Splats(zeros, quats, zeros - 10, absent, zeros.copy(), np.zeros((n, rest, 3), np.float32))
        self._owner = np.full(n, -1, np.int32)
        self._source = np.full(n, -1, np.int32)
        self._removed_at = np.full(n, -1, np.int32)
        self._tiles: dict[Key, _Held | None] = {}  # None: every splat of it has been replaced, and it is not kept
        self._by_index: list[_Held] = []
        self._late: dict[Key, list[tuple[int, bytes]]] = {}  # layers of tiles that are kept, though replaced
        self._replay: dict[Key, _Held] = {}
        self._kept_splats = self._late_bytes = 0
        self._shown_frame = -1
        self.keeps = True
        """Whether earlier frames of the group can be shown again from what is held."""
        self._rewound = False
        self._waiting: OrderedDict[Key, list[tuple[int, bytes]]] = OrderedDict()
        self._waiting_bytes = 0
        self._touched: dict[Key, _Held] = {}
        self._staged: dict[Key, _Staged] = {}
        self._ends: dict[int, Ids] = {}  # not yet shown
        self._ended: dict[int, Ids] = {}
        self._lock = threading.Lock()
        self._decoding = threading.Lock()

    # ------------------------------------------------------------------------------------------ arrival (decode thread)

    def add(self, frame: int, tile: int, from_lod: int, payloads: list[memoryview]) -> None:
        """Decode LoDs ``from_lod`` onwards of a tile. Duplicates change nothing.

        Raises :class:`DecodeError` for damaged payloads and ids beyond the group's capacity; what was held stays.
        """
        with self._decoding:
            self._add((frame, tile), from_lod, payloads)

    def flush(self, horizon: int | None = None) -> None:
        """Dequantise the tiles that :meth:`add` touched (of frames up to ``horizon``), each once, and stage them."""
        with self._decoding:
            near = self._shown_frame + REPLAY_AHEAD if horizon is None else horizon
            for key in [k for k in self._replay if k[0] <= near]:
                self._touched[key] = self._replay.pop(key)
            for key in [k for k in self._touched if horizon is None or k[0] <= horizon]:
                held = self._touched.pop(key)
                ids = held.state.ids
                self._check_ids(ids, f"tile {key[1]} of frame {key[0]}")
                staged = _Staged(held, ids, held.state.dequantise(), held.state.lod)
                with self._lock:
                    self._staged[key] = staged

    def _add(self, key: Key, from_lod: int, payloads: list[memoryview]) -> None:
        if key in self._tiles and self._tiles[key] is None:
            return
        held = self._tiles.get(key)
        layers = list(enumerate(payloads, start=from_lod))
        if held is not None and held.replaced:  # of use once earlier frames are shown again
            self._keep_late(key, layers)
            return
        changed = False
        if held is None:
            if from_lod > 0 or not layers:
                self._wait(key, layers)
                return
            held = self._open(key, layers[0][1])
            layers = layers[1:] + [(lod, memoryview(data)) for lod, data in self._stop_waiting(key)]
            changed = True
        for lod, payload in layers:
            changed |= lod > 0 and held.state.add_layer(lod, payload)
        if changed:
            self._touched[key] = held

    def end(self, frame: int, removed: Ids) -> None:
        """Nothing more is planned for ``frame``; ``removed`` ids end there. Raises :class:`DecodeError`."""
        self._check_ids(removed, f"removed ids of frame {frame}")
        with self._lock:
            if frame not in self._ended:
                self._ends[frame] = self._ended[frame] = removed

    def _open(self, key: Key, payload: memoryview) -> _Held:
        if len(self._by_index) >= MAX_TILES_PER_GOF:
            raise DecodeError(f"tile {key[1]} of frame {key[0]}: the group already has {MAX_TILES_PER_GOF} tiles")
        state = self.codec.open_tile(payload)
        self._check_ids(state.ids, f"tile {key[1]} of frame {key[0]}")
        low, high = (state.means.min(axis=0), state.means.max(axis=0)) if len(state) else (np.zeros(3), np.zeros(3))
        centre, radius = ((low + high) / 2).astype(np.float32), float(np.linalg.norm(high - low) / 2)
        held = _Held(len(self._by_index), key, state, centre, radius)
        with self._lock:
            self._by_index.append(held)
            self._tiles[key] = held
        return held

    def _check_ids(self, ids: Ids, what: str) -> None:
        if len(ids) and (int(ids.min()) < 0 or int(ids.max()) >= self.capacity):
            raise DecodeError(f"{what}: id {int(ids.max())} is outside the group's capacity {self.capacity}")

    def _keep_late(self, key: Key, layers: list[tuple[int, memoryview]]) -> None:
        with self._lock:
            self._late.setdefault(key, []).extend((lod, bytes(payload)) for lod, payload in layers)
            self._late_bytes += sum(len(payload) for _, payload in layers)
            if self._late_bytes > MAX_WAITING_BYTES:
                self._stop_keeping()

    def _wait(self, key: Key, layers: list[tuple[int, memoryview]]) -> None:
        """Keep layers whose base has not come yet; the oldest go when too many bytes wait."""
        kept = self._waiting.setdefault(key, [])
        for lod, payload in layers:
            kept.append((lod, bytes(payload)))
            self._waiting_bytes += len(payload)
        while self._waiting_bytes > MAX_WAITING_BYTES:
            _, dropped = self._waiting.popitem(last=False)
            self._waiting_bytes -= sum(len(data) for _, data in dropped)

    def _stop_waiting(self, key: Key) -> list[tuple[int, bytes]]:
        layers = self._waiting.pop(key, [])
        self._waiting_bytes -= sum(len(data) for _, data in layers)
        return layers

    # ----------------------------------------------------------------------------------------- display (display thread)

    def commit(self, frame: int) -> tuple[NDArray[np.intp], bool]:
        """Show what has come for frames up to ``frame``: the rows that changed, and whether ``frame`` is whole."""
        if frame < self._shown_frame:
            self._rewind()
        self._shown_frame = frame
        with self._lock:
            horizon = max((f for f in self._ended if f <= frame), default=-1)
        self.flush(horizon)
        with self._lock:
            updates = sorted(
                ((key, s) for key, s in self._staged.items() if key[0] <= horizon), key=lambda item: item[0]
            )
            ends = sorted((f, ids) for f, ids in self._ends.items() if f <= horizon)
            for key, _ in updates:
                del self._staged[key]
            for f, _ in ends:
                del self._ends[f]
            whole = frame in self._ended
        touched = np.zeros(self.capacity, dtype=bool)
        if self._rewound:
            touched[:], self._rewound = True, False
        for f, ids in ends:
            self._remove(f, ids, touched)
        for _, staged in updates:
            self._write(staged, touched)
        return np.nonzero(touched)[0], whole

    def _rewind(self) -> None:
        """Back to an empty picture; everything held waits to be shown again, in order."""
        with self._decoding, self._lock:
            self.splats.logit_opacities[:] = ABSENT_LOGIT
            for rows in (self._owner, self._source, self._removed_at):
                rows[:] = -1
            for key, held in self._tiles.items():
                if held is not None:
                    held.owned, held.shown_lod, held.replaced = 0, -1, False
                    self._replay[key] = held
                    for lod, payload in self._late.pop(key, []):
                        with suppress(DecodeError):  # damaged on the way: the tile stays as good as it was
                            held.state.add_layer(lod, payload)
            self._staged.clear()
            self._touched.clear()
            self._ends = dict(self._ended)
            self._kept_splats = self._late_bytes = 0
            self._rewound = True

    def holds(self, frame: int) -> bool:
        """Whether ``frame`` can be shown whole at once."""
        with self._lock:
            return self.keeps and frame in self._ended

    def _remove(self, frame: int, ids: Ids, touched: NDArray[np.bool_]) -> None:
        self._removed_at[ids] = np.maximum(self._removed_at[ids], frame)
        gone = ids[self._source[ids] < frame]
        self._release(gone)
        self._owner[gone] = -1
        self.splats.logit_opacities[gone] = ABSENT_LOGIT
        touched[gone] = True

    def _write(self, staged: _Staged, touched: NDArray[np.bool_]) -> None:
        held, ids = staged.held, staged.ids
        mine = self._owner[ids] == held.index
        newer = (self._source[ids] < held.frame) & (self._removed_at[ids] <= held.frame)
        claimed = ids[newer & ~mine]
        self._release(claimed)
        self._owner[claimed], self._source[claimed] = held.index, held.frame
        held.owned += len(claimed)
        write = mine | newer
        rows = ids[write]
        for (_, target), (_, values) in zip(self.splats.arrays(), staged.splats.arrays(), strict=True):
            target[rows] = values[write]
        touched[rows] = True
        held.shown_lod = staged.lod
        if not held.owned:
            self._forget(held)

    def _release(self, rows: Ids) -> None:
        """These rows leave the tiles that own them; a tile without rows is forgotten."""
        owners = self._owner[rows]
        counts = np.bincount(owners[owners >= 0], minlength=0)
        for index in np.nonzero(counts)[0]:
            held = self._by_index[index]
            held.owned -= int(counts[index])
            if not held.owned:
                self._forget(held)

    def _forget(self, held: _Held) -> None:
        """Nothing of a tile is shown any more: it is kept for a replay, as long as there is room."""
        if held.replaced:
            return
        with self._lock:
            self._staged.pop(held.key, None)
            held.replaced = True
            self._kept_splats += len(held.state)
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

    def lod_mean(self, camera: Camera, contribution: F32 | None = None) -> float:
        """Mean LoD of the shown splats in view; NaN where none is.

        Weighted by ``contribution`` [capacity], each splat's share in the picture, where that is known; else by tiles
        whose bounding sphere meets the view.
        """
        if contribution is not None:
            return self._lod_seen(contribution)
        with self._lock:
            shown = [h for h in self._tiles.values() if h is not None and h.owned and h.shown_lod >= 0]
        if not shown:
            return float("nan")
        centres = np.array([h.centre for h in shown], np.float64)
        radii = np.array([h.radius for h in shown])
        weights = np.array([h.owned for h in shown], np.float64) * _in_view(centres, radii, camera)
        lods = np.array([h.shown_lod for h in shown], np.float64)
        return float((weights * lods).sum() / weights.sum()) if weights.any() else float("nan")

    def _lod_seen(self, contribution: F32) -> float:
        held = self._owner >= 0
        weights = np.bincount(self._owner[held], weights=contribution[held], minlength=len(self._by_index))
        if not weights.sum() > 0:
            return float("nan")
        lods = np.array([tile.shown_lod for tile in self._by_index], np.float64)[: len(weights)]
        return float((weights[: len(lods)] * lods).sum() / weights.sum())

    @property
    def splats_held(self) -> int:
        """Rows that hold a splat."""
        return int((self._owner >= 0).sum())

    @property
    def full(self) -> bool:
        """Whether everything shown is at its highest LoD, so that nothing is left to restore."""
        top = self.manifest.lods - 1
        with self._lock:
            return all(h is None or not h.owned or h.shown_lod == top for h in self._tiles.values())


def _in_view(centres: NDArray[np.float64], radii: NDArray[np.float64], camera: Camera) -> NDArray[np.bool_]:
    """Which spheres meet the cone around the view's pyramid."""
    rotation, translation = camera.world_to_camera
    p = centres @ rotation.T + translation
    fov_x, fov_y = camera.intrinsics.fov_rad
    half = np.arctan(np.hypot(np.tan(fov_x / 2), np.tan(fov_y / 2)))
    distance = np.maximum(np.linalg.norm(p, axis=1), 1e-9)
    angle = np.arccos(np.clip(p[:, 2] / distance, -1.0, 1.0))
    spread = np.arcsin(np.clip(radii / distance, 0.0, 1.0))
    return np.asarray((angle <= half + spread) | (distance <= radii))


class TileStore:
    """The groups of frames that a client holds: the one on display and those that arrive ahead."""

    def __init__(self, manifest: Manifest, codec: TileCodec) -> None:
        self._manifest, self._codec = manifest, codec
        self._gofs: dict[int, GofStore] = {}
        self._shown: GofStore | None = None
        self._oldest = 0
        self._lock = threading.Lock()

    def add(self, frame: int, tile: int, from_lod: int, payloads: list[memoryview]) -> None:
        """Take layers of a tile; those of groups that are past are ignored. Raises :class:`DecodeError`."""
        store = self._store(frame)
        if store is not None:
            store.add(frame, tile, from_lod, payloads)

    def flush(self) -> None:
        """Dequantise what :meth:`add` touched, each tile once. Else :meth:`commit` does it, on the display path."""
        with self._lock:
            stores = list(self._gofs.values())
        for store in stores:
            store.flush()

    def end(self, frame: int, removed: Ids) -> None:
        """The server plans nothing more for ``frame``. Raises :class:`DecodeError`."""
        store = self._store(frame)
        if store is not None:
            store.end(frame, removed)

    def commit(self, frame: int) -> tuple[GofStore, Committed]:
        """Make what has come for ``frame`` visible.

        While nothing of its group is whole, the group before stays on display (``missed``).
        """
        gof = self._manifest.gof_of(frame)
        store = self._store(frame)
        assert store is not None, "frames are committed in order within a pass; reset() starts another"
        rows, whole = store.commit(frame)
        if not store.splats_held and self._shown is not None:
            return self._shown, Committed(gof, np.zeros(0, np.intp), False, True)
        fresh = store is not self._shown
        with self._lock:
            self._shown = store
            self._oldest = gof
            for old in [g for g in self._gofs if g < gof]:
                del self._gofs[old]
        return store, Committed(gof, rows, fresh, not whole)

    @property
    def keeps(self) -> bool:
        """Whether every frame of the group on display that was sent once can be shown again."""
        return self._shown is None or self._shown.keeps

    def in_group(self, frame: int) -> bool:
        """Whether ``frame`` is of the group on display."""
        return self._manifest.gof_of(frame) == self._oldest

    def holds(self, frame: int) -> bool:
        """Whether ``frame`` can be shown whole without anything from the network."""
        store = self._gofs.get(self._manifest.gof_of(frame))
        return store is not None and store.holds(frame)

    def reset(self, frame: int) -> None:
        """Forget everything: the viewer jumped to ``frame``."""
        with self._lock:
            self._gofs.clear()
            self._shown, self._oldest = None, self._manifest.gof_of(frame)

    def _store(self, frame: int) -> GofStore | None:
        if not 0 <= frame < self._manifest.frames:
            raise DecodeError(f"frame {frame} is outside the clip's {self._manifest.frames} frames")
        gof = self._manifest.gof_of(frame)
        with self._lock:
            if gof < self._oldest:
                return None
            if gof not in self._gofs:
                capacity = self._manifest.capacity[gof]
                self._gofs[gof] = GofStore(capacity, self._manifest.sh_degree, self._codec, self._manifest)
            return self._gofs[gof]
