"""Ghosts: splats that a client still shows in an old state because their change was not sent.

Changes out of view are not sent. When the viewer turns there, the client may show splats where the true scene has
none, and no visible splat would cause the sending of the tile that removes them. Therefore, tiles that the client
shows, that are out of date, and whose bounds are in view count as visible with a small weight. The weight is small
because bounds ignore occlusion; :class:`StaleSplats` covers splats that were really visible.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32, F64, Camera
from cags_common.tiles.kinds import TileKind
from cags_server.scene.library import SceneLibrary
from cags_server.scene.stays import LONGEST_STAY, LOOK_AHEAD
from cags_server.scene.tile_map import Numbers, TileMap
from cags_server.scene.visible_tiles import VisibleTile
from cags_server.visibility.bounds import distances_in_view
from cags_server.visibility.inventory import ClientInventory

GHOST_SHARE = 0.1
"""Weight of a possible ghost relative to a visible splat."""


@dataclass(frozen=True, eq=False)
class ShownLooks:
    """Tiles of the looks that a client shows, and of those that their splats have in the scene by now."""

    there: Numbers
    """[m] ascending."""
    counts: NDArray[np.intp]
    """[m] splats shown."""
    older: Numbers
    """[k] the shown tile, by pairs of a tile and one that replaces splats of it."""
    newer: Numbers
    """[k] the other one."""
    sizes: NDArray[np.intp]
    """[k] splats."""

    @staticmethod
    def of(shown: Numbers, owners: Numbers) -> ShownLooks:
        """``shown`` [capacity] is the tile of the displayed looks of each splat, ``owners`` [capacity] that of its
        looks in the scene; -1 for none.
        """
        counts = np.bincount(shown[shown >= 0])
        there = np.flatnonzero(counts)
        late = np.flatnonzero((shown != owners) & (shown >= 0) & (owners >= 0))
        tiles = int(owners.max(initial=0)) + 1
        pairs, sizes = np.unique(shown[late].astype(np.int64) * tiles + owners[late], return_counts=True)
        older, newer = (each.astype(np.int32) for each in np.divmod(pairs, tiles))
        return ShownLooks(there.astype(np.int32), counts[there], older, newer, sizes)


def ghosts(
    library: SceneLibrary, frame: int, camera: Camera, shown: ShownLooks, inventory: ClientInventory
) -> list[VisibleTile]:
    """Tiles that replace outdated splats of what is ``shown`` that ``camera`` may see at ``frame``; each weighs 1."""
    tiles, there, older, newer = library.tile_map(frame), shown.there, shown.older, shown.newer
    found = _lacking_motion(tiles, there, frame, inventory)
    in_view = _in_view(tiles, np.concatenate([there[found], older]), frame, camera, inventory)
    following = tiles.chunk_at(older, frame)  # possibly in flight with the looks that it moves
    there_soon = np.isfinite(distances_in_view(tiles.bounds[np.where(following >= 0, following, older)], camera))
    in_view[len(found) :] |= there_soon
    end = library.manifest.gof_frames(library.manifest.gof_of(frame))[-1]
    standing = found[in_view[: len(found)]]
    chunks = _chunks(tiles, there[standing], shown.counts[standing].tolist(), frame, end)
    replaced = zip(newer, shown.sizes, in_view[len(found) :], strict=True)
    return chunks + _newer(tiles, [(int(n), int(size)) for n, size, seen in replaced if seen], inventory)


def merged(visible: Sequence[VisibleTile], more: Sequence[VisibleTile]) -> tuple[VisibleTile, ...]:
    """``visible`` plus the tiles of ``more`` that are not among them, at a fraction of a visible splat's weight."""
    known = {(tile.frame, tile.tile) for tile in visible}
    looks = [tile for tile in visible if tile.kind == TileKind.LOOKS]
    splats = sum(tile.count for tile in looks)
    weight = GHOST_SHARE * (sum(tile.weight for tile in looks) / splats if splats else 1.0)
    added = [
        VisibleTile(t.frame, t.tile, t.count, weight * t.count, t.frames_left, t.kind, t.looks)
        for t in more
        if (t.frame, t.tile) not in known
    ]
    return (*visible, *added)


def _lacking_motion(tiles: TileMap, looks: Numbers, frame: int, inventory: ClientInventory) -> NDArray[np.intp]:
    """Rows of ``looks`` whose newest motion at ``frame`` the client lacks."""
    chunks = tiles.chunk_at(looks, frame)
    rows = np.flatnonzero(chunks >= 0)
    return rows[[not inventory.depth(*tiles.key(int(chunks[row]))) for row in rows]] if len(rows) else rows


def _in_view(
    tiles: TileMap, looks: Numbers, frame: int, camera: Camera, inventory: ClientInventory
) -> NDArray[np.bool_]:
    """Whether each tile of ``looks``, at the place where the client shows it, may be in view of ``camera``."""
    shown = {int(n): shown_bounds(tiles, int(n), frame, inventory) for n in np.unique(looks)}
    bounds = np.array([shown[int(n)] for n in looks], np.float64).reshape(-1, 2, 3)
    return np.isfinite(distances_in_view(bounds, camera))


def shown_bounds(tiles: TileMap, looks: int, frame: int, inventory: ClientInventory) -> F64:
    """Bounds [2, 3] of a tile of looks as a client shows it at ``frame``, by the newest motion that it holds."""
    held = (chunk for chunk in tiles.chunks_until(looks, frame) if inventory.depth(*tiles.key(chunk)))
    bounds: F64 = tiles.bounds[next(held, looks)]
    return bounds


def _chunks(tiles: TileMap, looks: Numbers, splats: list[int], frame: int, end: int) -> list[VisibleTile]:
    """The newest motion of each tile of ``looks``, of which so many ``splats`` are shown."""
    after = tiles.chunk_after(looks, frame)
    left = np.minimum(np.where(after >= 0, tiles.frames[after], end + 1) - frame, LONGEST_STAY).tolist()
    rows = zip(tiles.chunk_at(looks, frame).tolist(), looks.tolist(), splats, left, strict=True)
    return [
        VisibleTile(*tiles.key(chunk), count, float(count), stays, TileKind.MOTION, tiles.key(of))
        for chunk, of, count, stays in rows
    ]


def _newer(tiles: TileMap, replaced: list[tuple[int, int]], inventory: ClientInventory) -> list[VisibleTile]:
    """Looks that replace displayed ones: (number, splats) by displayed tile."""
    splats: dict[int, int] = {}
    for number, size in replaced:
        splats[number] = splats.get(number, 0) + size
    keys = {number: tiles.key(number) for number in splats}
    return [
        VisibleTile(*key, splats[number], float(splats[number]), LOOK_AHEAD)
        for number, key in keys.items()
        if not inventory.depth(*key)
    ]


class StaleSplats:
    """Splats of one client that were visible in a version that has been replaced since.

    Tiles are chosen by visibility in the true scene. A splat that leaves the picture between two frames is no longer
    visible, so its change would not be sent, and the client would keep drawing it at its old place, as a ghost. The
    splat therefore keeps its last visible weight until its newest version and motion have been sent.
    """

    def __init__(self, library: SceneLibrary, visible_px: float) -> None:
        self._library, self._visible_px = library, visible_px
        self._gof = -1
        self._ids: NDArray[np.intp] = np.zeros(0, np.intp)
        self._values: F32 = np.zeros(0, np.float32)

    def __len__(self) -> int:
        return len(self._ids)

    def added_to(self, contribution: F32, frame: int) -> F32:
        """``contribution`` [capacity] at ``frame``, and for stale splats at least their previous value."""
        if not len(self._ids) or self._library.manifest.gof_of(frame) != self._gof:
            return contribution
        out = contribution.copy()
        out[self._ids] = np.maximum(out[self._ids], self._values)
        return out

    def joined(self, splats: NDArray[np.intp], weights: F32, frame: int) -> tuple[NDArray[np.intp], F32]:
        """As :meth:`added_to`, of ``splats`` [n], ascending, that contribute ``weights`` [n]; all others nothing."""
        if not len(self._ids) or self._library.manifest.gof_of(frame) != self._gof:
            return splats, weights
        every = np.zeros(1 + int(max(splats.max(initial=0), self._ids[-1])), np.float32)
        every[splats] = weights
        every[self._ids] = np.maximum(every[self._ids], self._values)
        counted = np.zeros(len(every), bool)
        counted[splats] = counted[self._ids] = True
        both = np.flatnonzero(counted)
        return both, every[both]

    def update(self, contribution: F32, frame: int, inventory: ClientInventory) -> None:
        """After ``frame`` was planned: visible and stale splats that are neither held nor in flight are stale now."""
        seen = self.added_to(contribution, frame)
        ids = np.flatnonzero(seen > self._visible_px)
        numbers, where = np.unique(self._library.owners(frame)[ids], return_inverse=True)
        tiles = self._library.tile_map(frame)
        chunks = tiles.chunk_at(numbers, frame)
        lacks = [n >= 0 and not inventory.depth(*tiles.key(n)) for n in numbers.tolist()]
        stands = [n >= 0 and not inventory.depth(*tiles.key(n)) for n in chunks.tolist()]
        stale = (np.array(lacks, bool) | np.array(stands, bool)) & (numbers >= 0)
        ids = ids[stale[where]] if len(ids) else ids
        self._gof, self._ids, self._values = self._library.manifest.gof_of(frame), ids, seen[ids]
