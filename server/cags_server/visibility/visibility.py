"""Visibility of the scene for one client: from its last reference render, or from tile bounds before the first."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32, Camera
from cags_common.tiles.kinds import TileKind
from cags_server.scene.library import SceneLibrary
from cags_server.scene.tile_map import Numbers
from cags_server.scene.visible_tiles import VisibleTile
from cags_server.visibility.age import VersionAge
from cags_server.visibility.bounds import guessed_looks
from cags_server.visibility.ghosts import ShownLooks, StaleSplats, ghosts, merged
from cags_server.visibility.inventory import ClientInventory

Splats: TypeAlias = NDArray[np.intp]
"""Ids [n], ascending."""


class Visibility:
    """Visibility for one client. A tile is visible if it contributes at least ``visible_px`` pixels."""

    def __init__(self, library: SceneLibrary, visible_px: float) -> None:
        self.stale = StaleSplats(library, visible_px)
        self._library, self._visible_px = library, visible_px
        self._last: tuple[int, Splats, F32] | None = None  # group of frames; what its last picture showed, and how much
        self._shown: tuple[ShownLooks, int, Numbers] | None = None  # of which versions, and of which owners

    def rendered(self, frame: int, contribution: F32) -> None:
        """Take the ``contribution`` [capacity], pixels per splat, that the reference render of ``frame`` found."""
        splats = np.flatnonzero(contribution > self._visible_px)
        self._last = self._library.manifest.gof_of(frame), splats, contribution[splats]

    def tells_of(self, frame: int) -> bool:
        """Whether the last render is valid for ``frame``; it is not in another group of frames."""
        return self._last is not None and self._last[0] == self._library.manifest.gof_of(frame)

    def tiles(self, frame: int) -> tuple[VisibleTile, ...]:
        """Visibility at ``frame`` from the last render of its group."""
        assert self._last is not None, "nothing was rendered"
        return self._library.tiles_of(frame, *self.stale.joined(*self._last[1:], frame))

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
