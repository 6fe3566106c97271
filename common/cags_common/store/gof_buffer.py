"""The buffer of one group of frames: tiles at any depth, in any order of arrival.

Tiles are decoded on arrival (:mod:`cags_common.store.gof_tiles`). :meth:`GofBuffer.commit` makes all tiles of a frame
visible at once when that frame is shown; :mod:`cags_common.tiles.splat_buffer` combines looks, updates and motion into
one array of splats. The result is a function of the frame and of what arrived up to a mark. It does not depend on how
arrivals were batched or on earlier commits. Each group of frames has its own ids and its own store. Showing an earlier
frame of the group, or a group again that rested, replays held tiles, so a loop or a jump back needs no data from the
network.
"""

from __future__ import annotations

import math
import threading
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle.codecs import WHOLE_TILES_CODEC
from cags_common.bundle.manifest import Manifest
from cags_common.errors import DecodeError
from cags_common.geometry import F32
from cags_common.motion.chunk import LEVELS as MOTION_LEVELS
from cags_common.motion.chunk import Chunk
from cags_common.splats import Ids, Splats
from cags_common.store.gof_tiles import GofTiles
from cags_common.store.motions import LooksValue, Staged, StoredMotion, StoredUpdate
from cags_common.store.shown import Shown, StoredLooks
from cags_common.store.tile_decode import Arrival, Key, Opener
from cags_common.tiles.inventory import InventoryEntry
from cags_common.tiles.splat_buffer import Slot, SplatBuffer

UNTOUCHED = -1
"""In place of a media frame: nothing changed the row."""


@dataclass(frozen=True, slots=True)
class Changes:
    """Result of a commit."""

    rows: NDArray[np.intp]
    """[M] rows whose splats changed."""
    began: NDArray[np.int32]
    """[M] of each, the media frame of the newest tile or end of a splat that changed it."""
    moved: NDArray[np.intp]
    """[K] further rows, of which only position, rotation and opacity changed."""
    whole: bool
    """Whether the end of the frame had arrived."""


@dataclass(frozen=True, slots=True)
class Committed:
    """Rows that became visible: those that changed [M] or only moved [K]; all rows of a new group."""

    gof: int
    rows: NDArray[np.intp]
    began: NDArray[np.int32]
    """[M] as in :class:`Changes`."""
    moved: NDArray[np.intp]
    fresh: bool
    missed: bool
    """The end of this frame had not arrived, so an older frame is shown."""

    @property
    def changed(self) -> bool:
        """Whether anything became visible."""
        return self.fresh or len(self.rows) > 0 or len(self.moved) > 0


@dataclass(frozen=True, slots=True)
class _End:
    """The end of a frame, and the last mark that came before it."""

    mark: int
    removed: Ids


class GofBuffer:
    """One group of frames. One thread may add and flush while another commits, which never waits for a decoder."""

    def __init__(self, manifest: Manifest, gof: int, opener: Opener, mark: int = 0) -> None:
        """``mark`` is the last mark received."""
        self._manifest, self._gof, self._opener = manifest, gof, opener
        self.capacity = manifest.capacity[gof]
        frames, self._top_lod = manifest.gof_frames(gof), manifest.lods - 1
        myself = weakref.ref(self)  # a cycle would keep all splats until a collection finds it
        self._buffer = SplatBuffer(
            self.capacity, manifest.sh_degree, on_replaced=partial(_tell_replaced, myself), threads=opener.threads
        )
        layered, in_motion = manifest.codec != WHOLE_TILES_CODEC, manifest.motion is not None
        self._tiles = GofTiles(frames, self.capacity, opener, layered=layered, in_motion=in_motion, mark=mark)
        self._shown: list[StoredLooks] = []
        self._coarse: dict[Key, StoredMotion | StoredUpdate] = {}  # shown below its highest level
        self._shown_frame = self._horizon = -1
        self.whole = False
        """Whether the end of the displayed frame had arrived at its commit."""
        self.begun = False
        """Whether looks of any frame up to the displayed one have been shown."""
        self._rewound = self._resting = False
        self._ends: set[int] = set()  # not yet shown
        self._ended: dict[int, _End] = {}
        self._lock = threading.Lock()

    def resumed(self, inventory: Mapping[Key, int] | None) -> GofBuffer:
        """A new store with the LoDs of an inventory (None: that of :meth:`held`), without ends of frames."""
        other = GofBuffer(self._manifest, self._gof, self._opener, self._tiles.mark)
        other._tiles = self._tiles.resumed(inventory)
        return other

    @property
    def splats(self) -> Splats:
        """Splats on display; rows are ids. They change with :meth:`commit` and :meth:`move`."""
        return self._buffer.splats

    @property
    def nbytes(self) -> int:
        """What the splats by id take."""
        return self._buffer.nbytes

    @property
    def keeps(self) -> bool:
        """Whether the held tiles suffice to show earlier frames of the group again."""
        return self._tiles.keeps

    @property
    def kept_splats(self) -> int:
        """Splats that are held for a replay alone; motion and updates count as the splats that take as much memory."""
        return self._tiles.kept_splats

    # ------------------------------------------------------------------------------------------ arrival (decode thread)

    def add(self, arrivals: Sequence[Arrival]) -> list[DecodeError]:
        """Decode layers of tiles and return the errors of skipped ones. Duplicates change nothing."""
        return self._tiles.add(arrivals)

    def flush(self) -> list[DecodeError]:
        """Dequantise and stage the tiles that :meth:`add` touched, each once; returns the errors of skipped ones."""
        return self._tiles.flush()

    def mark(self, number: int) -> None:
        """What arrives from now on belongs to later marks. Call after :meth:`flush`, in the same thread."""
        self._tiles.mark = number

    def take_dropped(self) -> list[InventoryEntry]:
        """Tiles discarded for lack of memory since the last call; the server may send them again."""
        return self._tiles.take_dropped()

    def end(self, frame: int, removed: Ids) -> None:
        """The server plans nothing more for ``frame``; splats ``removed`` end there. Raises :class:`DecodeError`."""
        self._tiles.check_ids(removed, f"removed ids of frame {frame}")
        with self._lock:
            if frame not in self._ended:
                self._ended[frame] = _End(self._tiles.mark, removed)
                self._ends.add(frame)

    # ----------------------------------------------------------------------------------------- display (display thread)

    def commit(self, frame: int, basis: int | None = None) -> Changes:
        """Show frame ``frame`` with everything that arrived up to mark ``basis`` (None: everything).

        Tiles of later marks that an earlier frame showed stay visible. A frame before the displayed one shows the
        basis alone.
        """
        limit = math.inf if basis is None else basis
        horizon = self._newest_end(frame, limit)
        if frame < self._shown_frame or self._resting:
            self._rewind(horizon, limit)
        self._shown_frame, self._horizon = frame, max(self._horizon, horizon)
        ends = self._due(horizon, limit)
        self.whole = self._horizon >= frame and frame in self._ended
        self._tiles.stage_unless_decoding(horizon)
        updates = self._tiles.due(horizon, limit)
        began = np.full(self.capacity, UNTOUCHED, np.int32)
        if self._rewound:
            began[:], self._rewound = 0, False
        for f, ids in ends:
            _raise_to(began, self._buffer.remove(f, ids), f)
        for staged in updates:
            _raise_to(began, self._show(staged, float(frame)), staged.held.key[0])
        for rows, since in self._buffer.ramp(float(frame)):
            _raise_to(began, rows, since)
        moved = self._buffer.move(float(frame))
        self._forget_past(frame, changed=bool(updates or ends))
        touched = began != UNTOUCHED
        only = np.zeros(self.capacity, dtype=bool)
        only[moved] = True
        rows = np.nonzero(touched)[0]
        return Changes(rows, began[rows], np.nonzero(only & ~touched)[0], self.whole)

    def rest(self) -> None:
        """Another group is on display: free the splats until the next :meth:`commit`, which replays held tiles."""
        if self._shown_frame >= 0 and not self._resting:
            self._buffer.release()
            self._resting = True

    def move(self, time: float) -> NDArray[np.intp]:
        """Move the displayed splats to ``time``, after the committed frame; returns the moved rows [K]. Only position,
        rotation and opacity change.
        """
        return np.sort(self._buffer.move(time))

    def _show(self, staged: Staged, time: float) -> NDArray[np.integer]:
        """Apply a tile at ``time`` and return the changed rows; nothing moves before all tiles are applied."""
        held, value = staged.held, staged.value
        if isinstance(held, StoredLooks):
            assert isinstance(value, LooksValue)
            held.steps, held.grows = value.steps, value.grows
            self.begun |= len(value.ids) > 0
            if held.index < 0:
                held.index = len(self._buffer.slots)
                self._buffer.add(held)
                self._shown.append(held)
            return self._buffer.write(held, staged.lod, value.ids, value.splats)
        held.shown_lod, top = staged.lod, MOTION_LEVELS - 1
        rows = np.zeros(0, np.intp)
        if isinstance(held, StoredUpdate):
            assert isinstance(value, dict)
            held.ids_of, top = {column: change.ids for column, change in value.items()}, self._top_lod
            rows = self._buffer.update(held.key[0], value, time)
        elif held.versions is not None:
            assert isinstance(value, Chunk)
            self._buffer.set_motion(held.looks, held.key[0], value)
        if staged.lod < top:
            self._coarse[held.key] = held
        else:
            self._coarse.pop(held.key, None)
        return rows

    def _newest_end(self, frame: int, limit: float) -> int:
        """The newest frame up to ``frame`` whose end arrived before mark ``limit``; -1 for none."""
        with self._lock:
            return max((f for f, end in self._ended.items() if f <= frame and end.mark < limit), default=-1)

    def _due(self, horizon: int, limit: float) -> list[tuple[int, Ids]]:
        """Pending removals of frames up to ``horizon`` whose ends arrived before mark ``limit``."""
        with self._lock:
            frames = sorted(f for f in self._ends if f <= horizon and self._ended[f].mark < limit)
            self._ends.difference_update(frames)
            return [(f, self._ended[f].removed) for f in frames]

    def _rewind(self, horizon: int, limit: float) -> None:
        """Start from an empty picture, with all held tiles queued for display again in order."""
        self._buffer.clear()
        for looks in self._tiles.rewind(horizon, limit):
            self._buffer.drop_motion(looks)
        self._coarse.clear()
        with self._lock:
            self._ends = set(self._ended)
        self._rewound, self._resting, self.begun, self._horizon = True, False, False, -1

    def _replaced(self, slot: Slot) -> None:
        """A tile is no longer shown."""
        assert isinstance(slot, StoredLooks)
        if slot.replaced or slot.grows:
            return
        self._buffer.drop_motion(slot.key)
        self._forget(self._tiles.replaced(slot))

    def _forget_past(self, frame: int, *, changed: bool) -> None:
        """Expire replaced chunks of motion and, once nothing is kept, updates that no longer show anything."""
        self._forget(self._tiles.past(self._buffer.drop_past(frame)))
        if changed and not self.keeps:
            for update in self._tiles.updates():
                if not self._buffer.uses(update.key[0], update.ids_of):
                    self._tiles.forget(update)
                    self._forget([update])

    def _forget(self, changes: Sequence[StoredMotion | StoredUpdate]) -> None:
        for held in changes:
            self._coarse.pop(held.key, None)

    @property
    def shown_frame(self) -> int:
        """The frame on display; -1 before any."""
        return self._shown_frame

    @property
    def newest(self) -> int:
        """The newest complete frame; -1 before any."""
        with self._lock:
            return max(self._ended, default=-1)

    def holds(self, frame: int) -> bool:
        """Whether ``frame`` can be shown completely at once."""
        with self._lock:
            return self._tiles.keeps and frame in self._ended

    # ---------------------------------------------------------------------------------------------------------- figures

    @property
    def shown(self) -> Shown:
        """What is on display."""
        return Shown(self._buffer.owner, tuple(self._shown))

    def visible_lods(self, contribution: F32) -> dict[Key, int]:
        """LoDs of all tiles that determine a splat with a ``contribution`` [capacity] to the picture: its looks, its
        current motion, and updates.
        """
        out = self.shown.visible_lods(contribution)
        for looks in list(out):
            start = self._buffer.moves(looks)
            chunk = None if start is None else self._tiles.chunk(looks, start)
            if chunk is not None:
                out[chunk.key] = chunk.shown_lod + 1
        for update in self._tiles.updates():
            seen = any((contribution[ids] > 0).any() for ids in update.ids_of.values())
            if seen and self._buffer.uses(update.key[0], update.ids_of, shown=True):
                out[update.key] = update.shown_lod + 1
        return out

    def held(self) -> list[InventoryEntry]:
        """Held tiles of all kinds: those shown, waiting to be shown, or kept for a replay."""
        return self._tiles.held()

    @property
    def full(self) -> bool:
        """Whether all displayed tiles, motion and updates included, are at their highest LoD."""
        return self.shown.full(self._top_lod) and not any(map(self._counts, list(self._coarse.values())))

    def _counts(self, held: StoredMotion | StoredUpdate) -> bool:
        """Whether ``held`` determines any displayed splat."""
        if isinstance(held, StoredUpdate):
            return self._buffer.uses(held.key[0], held.ids_of, shown=True)
        looks = self._tiles.looks(held.looks)
        return looks is not None and looks.on_display and self._buffer.moves(held.looks) == held.key[0]


def _raise_to(began: NDArray[np.int32], rows: NDArray[np.integer], frame: int | NDArray[np.int32]) -> None:
    began[rows] = np.maximum(began[rows], frame)


def _tell_replaced(store: weakref.ref[GofBuffer], slot: Slot) -> None:
    told = store()
    if told is not None:
        told._replaced(slot)
