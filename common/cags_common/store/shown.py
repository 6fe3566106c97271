"""What of a group of frames is on display, tile of looks by tile, and the figures of its detail."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle.codecs import TileDecoder
from cags_common.geometry import F32, Camera
from cags_common.store.tile_decode import Key, Sphere, in_view
from cags_common.store.versions import Versions
from cags_common.tiles.splat_buffer import Slot


@dataclass(eq=False, kw_only=True)
class StoredLooks(Slot):
    """One tile of looks: what is decoded of it, and how many rows it still owns."""

    sphere: Sphere
    versions: Versions[TileDecoder]
    """What is decoded of it."""
    grows: bool = False
    """Whether levels that are not shown yet may bring more splats."""

    @property
    def on_display(self) -> bool:
        """Whether any of its splats is."""
        return self.owned > 0 and not self.ended

    @property
    def lods(self) -> int:
        """Levels that are decoded, from the base on without a gap."""
        return self.versions.newest.lod + 1


@dataclass(frozen=True, eq=False)
class Shown:
    """The splats on display and the tiles that they are from. A view of the store: it changes with the next commit."""

    owner: NDArray[np.int32]
    """[capacity] by splat id: place in ``tiles`` of the tile that it is from; -1 where there is no splat."""
    tiles: Sequence[StoredLooks]

    @property
    def splats(self) -> int:
        """Rows that hold a splat."""
        return int((self.owner >= 0).sum())

    def lods(self) -> NDArray[np.float32]:
        """[tiles] the LoD that each tile is shown at; -1 where nothing of it is."""
        return np.array([tile.shown_lod for tile in self.tiles], np.float32)

    def full(self, top_lod: int) -> bool:
        """Whether everything shown is at ``top_lod``, so that nothing is left to restore."""
        return all(not tile.on_display or tile.shown_lod == top_lod for tile in self.tiles)

    def lod_mean(self, camera: Camera, contribution: F32 | None = None) -> float:
        """Mean LoD of the shown splats in view; NaN where none is.

        Weighted by ``contribution`` [capacity], each splat's share in the picture, where that is known; else by tiles
        whose bounding sphere meets the view.
        """
        tiles = [tile for tile in self.tiles if tile.on_display and tile.shown_lod >= 0]
        if not tiles:
            return float("nan")
        if contribution is not None:
            held = self.owner >= 0
            of_all = np.bincount(self.owner[held], weights=contribution[held], minlength=len(self.tiles))
            weights = of_all[[tile.index for tile in tiles]]
        else:
            weights = np.array([tile.owned for tile in tiles]) * in_view([tile.sphere for tile in tiles], camera)
        lods = np.array([tile.shown_lod for tile in tiles], np.float64)
        return float((weights * lods).sum() / weights.sum()) if weights.sum() > 0 else float("nan")

    def visible_lods(self, contribution: F32) -> dict[Key, int]:
        """LoDs shown of each tile that has a splat with a ``contribution`` [capacity] to the picture."""
        owners = self.owner[(contribution > 0) & (self.owner >= 0)]
        return {tile.key: tile.shown_lod + 1 for tile in (self.tiles[index] for index in np.unique(owners))}
