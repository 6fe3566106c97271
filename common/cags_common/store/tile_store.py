"""The store of a scene: one :class:`GofBuffer` per group of frames.

A group is dropped when the next one is first shown, except in a small clip, which is kept whole. *Marks* divide the
stream into what a reference assumes and what comes later. Server and client number them alike, so both can show the
same splats.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Sequence

import numpy as np

from cags_common.bundle.codecs import TileCodec
from cags_common.bundle.manifest import Manifest
from cags_common.errors import DecodeError
from cags_common.splats import Ids
from cags_common.store import gof_tiles
from cags_common.store.gof_buffer import Changes, Committed, GofBuffer
from cags_common.store.tile_decode import Arrival, Opener, TileOpener
from cags_common.tiles.inventory import InventoryEntry


class TileStore:
    """The held groups of frames: the displayed one and those that arrive ahead.

    One thread may add, end, flush and mark while another commits and moves.
    """

    def __init__(
        self, manifest: Manifest, codec: TileCodec | None, threads: int = 1, *, opener: Opener | None = None
    ) -> None:
        """Decode with ``threads`` threads, whose number does not change results. ``opener`` replaces the decoders of
        ``codec``.
        """
        self._manifest, self._opener = manifest, opener or TileOpener(codec, threads)
        self._gofs: dict[int, GofBuffer] = {}
        self._shown: GofBuffer | None = None
        self._oldest = 0
        self._whole = manifest.kept_whole
        self._mark = 0
        self._lock = threading.Lock()

    # ------------------------------------------------------------------------------------------ arrival (decode thread)

    def add(self, frame: int, tile: int, from_lod: int, payloads: list[memoryview]) -> None:
        """Add layers of a tile; those of past groups are ignored. Raises :class:`DecodeError`."""
        for error in self.add_all([Arrival(frame, tile, from_lod, payloads)]):
            raise error

    def add_all(self, arrivals: Sequence[Arrival]) -> list[DecodeError]:
        """As :meth:`add`, for many at once; returns the errors of skipped ones."""
        errors: list[DecodeError] = []
        by_gof: dict[int, tuple[GofBuffer, list[Arrival]]] = {}
        for arrival in arrivals:
            try:
                store = self._store(arrival.frame)
            except DecodeError as error:
                errors.append(error)
                continue
            if store is not None:
                by_gof.setdefault(id(store), (store, []))[1].append(arrival)
        for store, some in by_gof.values():
            errors += store.add(some)
        return errors

    def flush(self) -> list[DecodeError]:
        """Dequantise the tiles that :meth:`add` touched, each once, and return the errors of skipped ones.

        Without it, :meth:`commit` does the same on the display path.
        """
        return [error for store in self._stores() for error in store.flush()]

    def mark(self, number: int) -> list[DecodeError]:
        """Everything received so far, ends of frames included, belongs to basis ``number``; what follows does not.

        Flushes, and returns the errors of that. Raises ``ValueError`` unless numbers rise.
        """
        if number <= self._mark:
            raise ValueError(f"mark {number} came after mark {self._mark}: marks rise")
        errors = self.flush()
        with self._lock:
            self._mark = number
            for store in self._gofs.values():
                store.mark(number)
        return errors

    def end(self, frame: int, removed: Ids) -> None:
        """The server plans nothing more for ``frame``. Raises :class:`DecodeError`."""
        store = self._store(frame)
        if store is not None:
            store.end(frame, removed)

    def take_dropped(self) -> list[InventoryEntry]:
        """Tiles discarded for lack of memory since the last call."""
        return [tile for store in self._stores() for tile in store.take_dropped()]

    def restarted(self, inventory: Iterable[InventoryEntry] | None = None) -> None:
        """Continue with another connection, which begins from ``inventory`` (None: that of :meth:`held`).

        The displayed picture stays until the first end of a frame arrives. Levels beyond the inventory, incomplete
        levels and ends of frames are forgotten; marks continue to rise.
        """
        levels = None if inventory is None else {(tile.frame, tile.tile): tile.lods for tile in inventory}
        with self._lock:
            before = dict(self._gofs)
        resumed = {gof: store.resumed(levels) for gof, store in before.items()}
        with self._lock:
            self._gofs = resumed

    def reset(self, frame: int) -> None:
        """Forget everything: the viewer jumped to ``frame``."""
        with self._lock:
            self._gofs.clear()
            self._shown, self._oldest = None, self._manifest.gof_of(frame)
            self._whole = self._manifest.kept_whole

    # ----------------------------------------------------------------------------------------- display (display thread)

    def commit(self, frame: int, basis: int | None = None) -> tuple[GofBuffer, Committed]:
        """Show what arrived for ``frame`` up to mark ``basis`` (None: everything).

        Until a frame of its group is complete, the last frame of the group before stays on display (``missed``); where
        the clip is kept whole, the one before the first group is the last.
        Tiles shown by an earlier commit stay even if they arrived after ``basis``, unless playback went back.
        """
        gof = self._manifest.gof_of(frame)
        made: dict[GofBuffer, Changes] = {}
        wanted = self._store(frame)
        assert wanted is not None, "frames are committed in order within a pass; reset() starts another"
        begun = None
        for number, store in self._back_from(gof):
            made[store] = store.commit(frame if number == gof else self._manifest.gof_frames(number)[-1], basis)
            if store.begun:
                begun = store
                self._show_group(number, gof)
                break
        shown = begun or self._shown or wanted
        none = np.zeros(0, np.intp)
        changes = made.get(shown, Changes(none, none.astype(np.int32), none, False))
        fresh, self._shown = shown is not self._shown, shown
        missed = shown is not wanted or not changes.whole
        return shown, Committed(gof, changes.rows, changes.began, changes.moved, fresh, missed)

    def _show_group(self, gof: int, wanted: int) -> None:
        """Group ``gof`` is on display in place of ``wanted``: past ones are dropped; where the clip is kept whole, the
        others rest.
        """
        with self._lock:
            self._oldest = min(gof, wanted)  # later where the last group is shown before the first
            stores = self._gofs.values()
            kept = sum(store.kept_splats for store in stores) if self._opener.bounded else 0
            self._whole &= all(store.keeps for store in stores) and kept <= gof_tiles.MAX_KEPT_SPLATS
            for number in [number for number in self._gofs if number not in (gof, wanted)]:
                if self._whole:
                    self._gofs[number].rest()
                elif number < self._oldest:
                    del self._gofs[number]

    def move(self, frame: int, share: float) -> tuple[GofBuffer, Committed] | None:
        """Move the displayed splats to their place ``share`` frames after ``frame``; None unless ``frame`` was the last
        committed one.
        """
        store = self._shown
        if store is None or store.shown_frame != frame:
            return None
        gof = self._manifest.gof_of(frame)
        rows, began = np.zeros(0, np.intp), np.zeros(0, np.int32)
        return store, Committed(gof, rows, began, store.move(frame + share), False, not store.whole)

    # ---------------------------------------------------------------------------------------------------------- figures

    @property
    def on_display(self) -> GofBuffer | None:
        """The group of frames on display; None before any."""
        return self._shown

    @property
    def kept(self) -> range:
        """Frames among which playback can jump and go on with what is held of them: those of the clip, of the displayed
        group, or none.
        """
        if self._whole and all(store.keeps for store in self._stores()):
            return range(self._manifest.frames)
        if self._shown is None or self._shown.keeps:
            return self._manifest.gof_frames(self._oldest)
        return range(0)

    def capacity(self, frame: int) -> int:
        """One more than the largest splat id in the group of ``frame``. Raises :class:`DecodeError`."""
        self._check(frame)
        return self._manifest.capacity[self._manifest.gof_of(frame)]

    def reaches(self, frame: int) -> bool:
        """Whether ``frame`` can still be committed: its group has not been dropped."""
        return self._whole or self._manifest.gof_of(frame) >= self._oldest

    @property
    def nbytes(self) -> int:
        """Memory of the splats by id, bytes."""
        return sum(store.nbytes for store in self._stores())

    def holds(self, frame: int) -> bool:
        """Whether ``frame`` can be shown completely without further data."""
        store = self._gofs.get(self._manifest.gof_of(frame))
        return store is not None and store.holds(frame)

    def ahead(self, frame: int) -> int:
        """Number of frames after ``frame`` up to the newest complete one."""
        return max(max((store.newest for store in self._stores()), default=-1) - frame, 0)

    def held(self) -> list[InventoryEntry]:
        """All tiles that need not be sent again."""
        return [tile for store in self._stores() for tile in store.held()]

    def _check(self, frame: int) -> None:
        if not 0 <= frame < self._manifest.frames:
            raise DecodeError(f"frame {frame} is outside the clip's {self._manifest.frames} frames")

    def _stores(self) -> list[GofBuffer]:
        with self._lock:
            return list(self._gofs.values())

    def _back_from(self, gof: int) -> list[tuple[int, GofBuffer]]:
        """The held groups from ``gof`` on, each followed by the one that is displayed before it."""
        count = len(self._manifest.gof_starts)
        with self._lock:
            there = [(number, store) for number, store in self._gofs.items() if self._whole or number <= gof]
        return sorted(there, key=lambda each: (gof - each[0]) % count)

    def _store(self, frame: int) -> GofBuffer | None:
        self._check(frame)
        gof = self._manifest.gof_of(frame)
        with self._lock:
            if gof < self._oldest and not self._whole:
                return None
            if gof not in self._gofs:
                self._gofs[gof] = GofBuffer(self._manifest, gof, self._opener, self._mark)
            return self._gofs[gof]
