"""The displayed tiles of looks of a group of frames, and figures of their detail."""

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
    """One tile of looks: its decoded levels, and the number of rows that it still owns."""

    sphere: Sphere
    versions: Versions[TileDecoder]
    """Its decoded levels."""
    grows: bool = False
    """Whether levels that are not yet shown may add splats."""

    @property
    def on_display(self) -> bool:
        """Whether any of its splats is shown."""
        return self.owned > 0 and not self.ended

    @property
    def lods(self) -> int:
        """Number of decoded levels, from the base on without a gap."""
        return self.versions.newest.lod + 1


@dataclass(frozen=True, eq=False)
class Shown:
    """The displayed splats and their tiles. This is a view of the store, which changes with the next commit."""

    owner: NDArray[np.int32]
    """[capacity] by splat id: index in ``tiles`` of the splat's tile; -1 for no splat."""
    tiles: Sequence[StoredLooks]

    @property
    def splats(self) -> int:
        """Rows that hold a splat."""
        return int((self.owner >= 0).sum())

    def lods(self) -> NDArray[np.float32]:
        """[tiles] displayed LoD of each tile; -1 if nothing of it is displayed."""
        return np.array([tile.shown_lod for tile in self.tiles], np.float32)

    def full(self, top_lod: int) -> bool:
        """Whether everything displayed is at ``top_lod``, so that nothing is left to restore."""
        return all(not tile.on_display or tile.shown_lod == top_lod for tile in self.tiles)

    def lod_mean(self, camera: Camera, contribution: F32 | None = None) -> float:
        """Mean LoD of the displayed splats in view; NaN for none.

        Splats are weighted by ``contribution`` [capacity] to the picture. If it is unknown, the splats of tiles whose
        bounding spheres meet the view count equally.
        """
        lods, weights = self._in_view(camera, contribution)
        return float((weights * lods).sum() / weights.sum()) if weights.sum() > 0 else float("nan")

    def error_mean(self, camera: Camera, errors: NDArray[np.float64]) -> float:
        """Mean, over the displayed splats in view, of what their LoD has of ``errors`` [lods]; NaN for none. Unlike the
        error at the mean LoD it tells a picture of which a part is coarse from one of middling detail.
        """
        lods, weights = self._in_view(camera, None)
        return float((weights * errors[lods]).sum() / weights.sum()) if weights.sum() > 0 else float("nan")

    def _in_view(self, camera: Camera, contribution: F32 | None) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
        """Displayed LoDs of tiles, and how much each counts."""
        tiles = [tile for tile in self.tiles if tile.on_display and tile.shown_lod >= 0]
        if not tiles:
            return np.zeros(0, np.intp), np.zeros(0)
        if contribution is not None:
            held = self.owner >= 0
            of_all = np.bincount(self.owner[held], weights=contribution[held], minlength=len(self.tiles))
            weights = of_all[[tile.index for tile in tiles]]
        else:
            weights = np.array([tile.owned for tile in tiles]) * in_view([tile.sphere for tile in tiles], camera)
        return np.array([tile.shown_lod for tile in tiles], np.intp), weights.astype(np.float64)

    def visible_lods(self, contribution: F32) -> dict[Key, int]:
        """Displayed LoDs of each tile that has a splat with a ``contribution`` [capacity] to the picture."""
        owners = self.owner[(contribution > 0) & (self.owner >= 0)]
        return {tile.key: tile.shown_lod + 1 for tile in (self.tiles[index] for index in np.unique(owners))}
