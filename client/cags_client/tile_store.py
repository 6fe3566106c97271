"""What the client holds of the scene: a :class:`GofStore` a group of frames.

The old group is dropped when the first frame of the next is shown.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence

import numpy as np

from cags_client.gof_store import Committed, GofStore
from cags_client.opening import Arrival, TileOpener
from cags_client.past import EarlierGroups
from cags_common.bundle.manifest import Manifest
from cags_common.codecs import TileCodec
from cags_common.errors import DecodeError
from cags_common.splats import Ids
from cags_protocol.messages import HeldTile


class TileStore:
    """The groups of frames that a client holds: the one on display and those that arrive ahead."""

    def __init__(self, manifest: Manifest, codec: TileCodec, threads: int = 1) -> None:
        """``threads`` of decoding; what is shown does not depend on their number."""
        self._manifest, self._opener = manifest, TileOpener(codec, threads)
        self._gofs: dict[int, GofStore] = {}
        self._shown: GofStore | None = None
        self._oldest = 0
        self.earlier = EarlierGroups()
        """What was on display before the group of frames that is."""
        self._lock = threading.Lock()

    def add(self, frame: int, tile: int, from_lod: int, payloads: list[memoryview]) -> None:
        """Take layers of a tile; those of groups that are past are ignored. Raises :class:`DecodeError`."""
        for error in self.add_all([Arrival(frame, tile, from_lod, payloads)]):
            raise error

    def add_all(self, arrivals: Sequence[Arrival]) -> list[DecodeError]:
        """As :meth:`add`, for many at once; what is wrong with those that are left out."""
        errors: list[DecodeError] = []
        by_gof: dict[int, tuple[GofStore, list[Arrival]]] = {}
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
        """Dequantise what :meth:`add` touched, each tile once. Else :meth:`commit` does it, on the display path.

        What is wrong with tiles that are left out.
        """
        with self._lock:
            stores = list(self._gofs.values())
        return [error for store in stores for error in store.flush()]

    def take_dropped(self) -> list[HeldTile]:
        """What was given up for want of memory since the last call."""
        with self._lock:
            stores = list(self._gofs.values())
        return [tile for store in stores for tile in store.take_dropped()]

    def capacity(self, frame: int) -> int:
        """One more than the largest splat id in the group of ``frame``. Raises :class:`DecodeError`."""
        self._check(frame)
        return self._manifest.capacity[self._manifest.gof_of(frame)]

    def end(self, frame: int, removed: Ids) -> None:
        """The server plans nothing more for ``frame``. Raises :class:`DecodeError`."""
        store = self._store(frame)
        if store is not None:
            store.end(frame, removed)

    def commit(self, frame: int, span: int = 0) -> tuple[GofStore, Committed]:
        """Make what has come for ``frame`` visible; what it was is remembered for ``span`` frames.

        While nothing of its group is whole, the group before stays on display (``missed``).
        """
        gof = self._manifest.gof_of(frame)
        store = self._store(frame)
        assert store is not None, "frames are committed in order within a pass; reset() starts another"
        store.past.span = span
        changes = store.commit(frame)
        if not store.shown.splats and self._shown is not None:
            none = np.zeros(0, np.intp)
            return self._shown, Committed(gof, none, none, False, True)
        fresh = store is not self._shown
        if fresh and span and self._shown is not None:
            self.earlier.add(self._shown.shown_frame, self._shown.splats, self._shown.past)
        self.earlier.advance(frame - span)
        with self._lock:
            self._shown = store
            self._oldest = gof
            for old in [g for g in self._gofs if g < gof]:
                del self._gofs[old]
        return store, Committed(gof, changes.rows, changes.moved, fresh, not changes.whole)

    def move(self, frame: int, share: float) -> tuple[GofStore, Committed] | None:
        """Show the splats on display where they are ``share`` frames after ``frame``, the last that was committed; None
        where another is.
        """
        store = self._shown
        if store is None or store.shown_frame != frame:
            return None
        gof = self._manifest.gof_of(frame)
        return store, Committed(gof, np.zeros(0, np.intp), store.move(frame + share), False, not store.whole)

    @property
    def on_display(self) -> GofStore | None:
        """The group of frames on display; None before any."""
        return self._shown

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

    def ahead(self, frame: int) -> int:
        """Frames after ``frame`` up to the newest that has come whole."""
        with self._lock:
            stores = list(self._gofs.values())
        return max(max((store.newest for store in stores), default=-1) - frame, 0)

    def held(self) -> list[HeldTile]:
        """Every tile that would not have to be sent again."""
        with self._lock:
            stores = list(self._gofs.values())
        return [tile for store in stores for tile in store.held()]

    def reset(self, frame: int) -> None:
        """Forget everything: the viewer jumped to ``frame``."""
        with self._lock:
            self._gofs.clear()
            self._shown, self._oldest = None, self._manifest.gof_of(frame)
        self.earlier.clear()

    def _check(self, frame: int) -> None:
        if not 0 <= frame < self._manifest.frames:
            raise DecodeError(f"frame {frame} is outside the clip's {self._manifest.frames} frames")

    def _store(self, frame: int) -> GofStore | None:
        self._check(frame)
        gof = self._manifest.gof_of(frame)
        with self._lock:
            if gof < self._oldest:
                return None
            if gof not in self._gofs:
                self._gofs[gof] = GofStore(self._manifest, gof, self._opener)
            return self._gofs[gof]
