"""Visibility of the scene for one client: from its last reference render, or from tile bounds before the first."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32, Camera
from cags_common.tiles.kinds import TileKind
from cags_server.scene.library import SceneLibrary
from cags_server.scene.tile_map import Numbers
from cags_server.scene.visible_tiles import VisibleTile
from cags_server.visibility.age import VersionAge
from cags_server.visibility.bounds import guessed_looks, tile_distances
from cags_server.visibility.ghosts import ShownLooks, StaleSplats, ghosts, merged
from cags_server.visibility.inventory import ClientInventory

Splats: TypeAlias = NDArray[np.intp]
"""Ids [n], ascending."""


@dataclass(frozen=True, eq=False)
class _Picture:
    """What the last render showed."""

    gof: int
    frame: int
    camera: Camera
    splats: Splats
    weights: F32  # [n] pixels of each
    owners: Numbers  # [capacity] at that frame; the library no longer has them when many frames have passed


class Visibility:
    """Visibility for one client. A tile is visible if it contributes at least ``visible_px`` pixels."""

    def __init__(self, library: SceneLibrary, visible_px: float) -> None:
        self.stale = StaleSplats(library, visible_px)
        self._library, self._visible_px = library, visible_px
        self._last: _Picture | None = None
        self._shown: tuple[ShownLooks, int, Numbers] | None = None  # of which versions, and of which owners

    def rendered(self, frame: int, contribution: F32, camera: Camera) -> None:
        """Take the ``contribution`` [capacity], pixels per splat, to the render of ``frame`` from ``camera``."""
        splats = np.flatnonzero(contribution > self._visible_px)
        gof = self._library.manifest.gof_of(frame)
        owners = self._library.owners(frame)
        self._last = _Picture(gof, frame, camera, splats, contribution[splats], owners)

    def tells_of(self, frame: int) -> bool:
        """Whether the last render is valid for ``frame``; it is not in another group of frames."""
        return self._last is not None and self._last.gof == self._library.manifest.gof_of(frame)

    def tiles(self, frame: int) -> tuple[VisibleTile, ...]:
        """Visibility at ``frame`` from the last render of its group.

        Splats that have appeared since are in no render. They count like the average splat if the bounds of their tile
        are in view; otherwise nothing of them would be sent before the next render.
        """
        last = self._last
        assert last is not None, "nothing was rendered"
        splats, weights = self.stale.joined(last.splats, last.weights, frame)
        if frame > last.frame:
            splats, weights = self._with_new(last, splats, weights, frame)
        return self._library.tiles_of(frame, splats, weights)

    def _with_new(self, last: _Picture, splats: Splats, weights: F32, frame: int) -> tuple[Splats, F32]:
        """``splats`` [n] and their ``weights`` [n] at ``frame``, and those that have appeared since ``last``."""
        then, now = last.owners, self._library.owners(frame)
        # With motion, new looks are of a new splat, whose id may have been another's. Without it, splats that only
        # changed have new looks, too.
        appeared = (now >= 0) & (then < 0 if self._library.manifest.motion is None else now != then)
        if not appeared.any():
            return splats, weights
        every = np.zeros(len(now), np.float32)
        every[splats] = weights
        new = np.flatnonzero(appeared)
        numbers = np.flatnonzero(np.bincount(now[new])).astype(np.int32)
        in_view = np.zeros(int(numbers[-1]) + 1, np.bool_)
        in_view[numbers] = np.isfinite(tile_distances(self._library, frame, numbers, last.camera))
        every[new] = np.where(in_view[now[new]], last.weights.sum() / max((then >= 0).sum(), 1), 0.0)
        found = np.flatnonzero(every > 0)
        return found, every[found]

    def guessed_tiles(self, frame: int, camera: Camera, pixels: int) -> tuple[VisibleTile, ...]:
        """Estimate, from tile bounds, of what a render of ``pixels`` pixels from ``camera`` would show."""
        return self._library.tiles_of_looks(frame, guessed_looks(self._library, frame, camera, pixels))

    def with_ghosts(
        self,
        visible: tuple[VisibleTile, ...],
        frame: int,
        camera: Camera,
        inventory: ClientInventory,
        age: VersionAge,
    ) -> tuple[VisibleTile, ...]:
        """``visible`` at ``frame`` plus tiles that replace outdated splats which the client may show to ``camera``."""
        found: dict[tuple[int, int], VisibleTile] = {}
        coming = _new_looks(visible, inventory)
        while True:  # a replacing tile may contain splats that have themselves been replaced since
            more = ghosts(self._library, frame, camera, self._shown_looks(frame, coming, age), inventory)
            found |= {(tile.frame, tile.tile): tile for tile in more}
            fresh = _new_looks(more, inventory) - coming
            if not fresh:
                return merged(visible, tuple(found.values()))
            coming |= fresh

    def _shown_looks(self, frame: int, coming: set[tuple[int, int]], age: VersionAge) -> ShownLooks:
        """What the client shows, or will with ``coming``; as before while neither that nor the scene's looks change."""
        owners, version = self._library.owners(frame), age.version(frame)
        if coming:
            return ShownLooks.of(age.shown_with(frame, coming), owners)
        if self._shown is None or self._shown[1] != version or self._shown[2] is not owners:
            self._shown = ShownLooks.of(age.shown_with(frame, ()), owners), version, owners
        return self._shown[0]

    def served(self, frame: int, contribution: F32, inventory: ClientInventory) -> None:
        """After the tiles of ``frame`` were chosen: visible splats that are neither held nor in flight become stale."""
        self.stale.update(contribution, frame, inventory)


def _new_looks(tiles: Iterable[VisibleTile], inventory: ClientInventory) -> set[tuple[int, int]]:
    """Looks (media frame, tile) of which the client holds nothing."""
    keys = {(tile.frame, tile.tile) for tile in tiles if tile.kind == TileKind.LOOKS}
    return {key for key in keys if not inventory.depth(*key)}
