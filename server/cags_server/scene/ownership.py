"""Who a splat's looks and single attributes are from, frame by frame, as a client with every tile would have it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle import BundleReader
from cags_common.splats import Ids
from cags_common.tiles.kinds import TileKind
from cags_common.tiles.updates import UPDATE_COLUMNS, UpdateState
from cags_server.scene.tile_map import TileMap

ATTRIBUTES = {"scale": 0, "opacity": 1, "alpha": 1, "sh0": 2, "sh1": 3, "sh2": 3, "sh3": 3}
"""Attribute -> row of :attr:`Owners.updates`; bands of harmonics change together."""


@dataclass(frozen=True, eq=False)
class Owners:
    """At one frame, by tile number. Arrays are shared between frames: never write to them."""

    looks: NDArray[np.int32]
    """[capacity] the tile of each splat's newest looks; -1 where there is no splat."""
    updates: NDArray[np.int32] | None
    """[attributes, capacity] the newest update of each attribute; -1 where looks are all there is. None: no updates."""

    counts: NDArray[np.bool_] | None
    """[attributes, capacity] true where an update's tile is that of no attribute before: a tile counts once a splat."""

    @property
    def nbytes(self) -> int:
        """Memory, about: a frame that changes nothing shares that of the one before."""
        return sum(array.nbytes for array in (self.looks, self.updates, self.counts) if array is not None)

    @staticmethod
    def none(capacity: int, *, updates: bool) -> Owners:
        """Before the first frame of a group."""
        looks = np.full(capacity, -1, np.int32)
        if not updates:
            return Owners(looks, None, None)
        shape = len(UPDATE_COLUMNS), capacity
        return Owners(looks, np.full(shape, -1, np.int32), np.zeros(shape, bool))


def advanced(before: Owners, reader: BundleReader, tiles: TileMap, frame: int) -> Owners:
    """The owners at ``frame``, from those of the frame before."""
    removed, entry = reader.removed_ids(frame), reader.frame(frame)
    kinds = {tile.kind for tile in entry.tiles}
    now = before
    if len(removed) or TileKind.LOOKS in kinds:
        now = replace(now, looks=now.looks.copy())
        now.looks[removed] = -1
    if now.updates is not None and now.counts is not None and (len(removed) or kinds - {TileKind.MOTION}):
        updates, counts = now.updates.copy(), now.counts.copy()
        updates[:, removed], counts[:, removed] = -1, False
        now = replace(now, updates=updates, counts=counts)
    for tile in entry.tiles:
        if tile.kind == TileKind.LOOKS:
            _take_looks(now, reader.tile_ids(frame, tile.tile), tiles.number(frame, tile.tile))
        elif tile.kind == TileKind.UPDATE:
            _take_update(now, reader, frame, tile.tile, tiles.number(frame, tile.tile))
    return now


def _take_looks(now: Owners, ids: Ids, number: int) -> None:
    now.looks[ids] = number
    if now.updates is not None and now.counts is not None:
        now.updates[:, ids], now.counts[:, ids] = -1, False


def _take_update(now: Owners, reader: BundleReader, frame: int, tile: int, number: int) -> None:
    state = reader.open_tile(frame, tile)
    if now.updates is None or now.counts is None or not isinstance(state, UpdateState):
        return
    for name, mask in state.changed.items():
        if name in ATTRIBUTES:
            now.updates[ATTRIBUTES[name], state.ids[mask]] = number
    numbers = now.updates[:, state.ids]
    counts = numbers >= 0
    for row in range(1, len(numbers)):
        counts[row] &= ~(numbers[:row] == numbers[row]).any(axis=0)
    now.counts[:, state.ids] = counts
