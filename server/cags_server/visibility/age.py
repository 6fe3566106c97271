"""The displayed version of each tile's splats, and for how long it has been out of date.

If the media replaces everything in every frame and the link carries only a part, the splats that have been out of date
longest are worth most. Judged by the current frame alone, the same tiles would win every time.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common.tiles.kinds import TileKind
from cags_server.scene.library import SceneLibrary
from cags_server.visibility.inventory import ClientInventory

NOTHING = np.iinfo(np.int32).max
"""In place of a media frame: nothing is lacked."""


@dataclass(eq=False)
class _Versions:
    """Of a group of frames: the number of the tile that brings each splat's looks, -1 for none; and lacking updates."""

    arrived: NDArray[np.int32]  # [capacity]
    sent: NDArray[np.int32]  # [capacity] those on their way, too
    lacked: NDArray[np.int32]  # [capacity] media frame of the first update that is lacked; [0] without updates
    number: int = 0  # that of the newest change to ``sent``


class VersionAge:
    """Looks of each splat that one client holds or is being sent, for the group of frames that was entered last and the
    one before it, which may still be on display; for all groups of a clip that is kept whole.
    """

    def __init__(self, library: SceneLibrary) -> None:
        self._library = library
        self._changes = 0
        self.clear()

    def clear(self) -> None:
        """The client holds nothing."""
        self._entered = -1
        self._groups: dict[int, _Versions] = {}
        self._claimed: tuple[tuple[int, int], ...] = ()

    def held(self, tiles: Iterable[tuple[int, int]]) -> None:
        """Take the inventory (media frame, tile) that the client holds from an earlier session.

        It is looked up when the group begins; tiles that are not in the bundle are ignored.
        """
        self._claimed = tuple(tiles)

    def shown_with(self, frame: int, more: Iterable[tuple[int, int]]) -> NDArray[np.int32]:
        """[capacity] the tile whose looks of a splat the client shows, or will with ``more`` (media frame, tile).

        By tile numbers within the group of ``frame``; -1: it shows none. Never write to it. A new tile may bring, with
        what is seen of it, splats that have been replaced since.
        """
        versions = self._of(frame)
        if versions is None:
            return np.full(self._library.manifest.capacity[self._library.manifest.gof_of(frame)], -1, np.int32)
        keys = tuple(more)
        if not keys:
            return versions.sent
        shown = versions.sent.copy()
        for key in keys:
            ids = self._library.tile_ids(*key)
            shown[ids] = np.maximum(shown[ids], self._number(*key))
        return shown

    def version(self, frame: int) -> int:
        """A number that changes with what :meth:`shown_with` says of the group of ``frame``, without more tiles, and
        with the group.
        """
        versions = self._of(frame)
        return -1 if versions is None else versions.number

    def sent(self, frame: int, tile: int) -> None:
        """The looks or an update of a tile's splats were queued; motion changes nothing here."""
        kind = self._kind(frame, tile)
        versions = None if kind == TileKind.MOTION else self._of(frame)
        if versions is None:
            return
        ids = self._library.tile_ids(frame, tile)
        if len(versions.lacked):
            versions.lacked[ids] = NOTHING
        if kind == TileKind.LOOKS:
            versions.sent[ids] = np.maximum(versions.sent[ids], self._number(frame, tile))
            self._changed(versions)

    def settled(self, frame: int, tile: int, *, delivered: bool) -> None:
        """They have arrived, or will not arrive."""
        versions = self._groups.get(self._library.manifest.gof_of(frame))
        if versions is None or (kind := self._kind(frame, tile)) == TileKind.MOTION:
            return
        ids, number, sent = self._library.tile_ids(frame, tile), self._number(frame, tile), versions.sent
        if kind == TileKind.UPDATE:
            if not delivered:
                versions.lacked[ids] = np.minimum(versions.lacked[ids], frame)
        elif delivered:
            versions.arrived[ids] = np.maximum(versions.arrived[ids], number)
        else:
            sent[ids] = np.where(sent[ids] == number, versions.arrived[ids], sent[ids])
            self._changed(versions)

    def lost(self, frame: int, tile: int) -> None:
        """The client has discarded a tile and shows nothing of it."""
        manifest = self._library.manifest
        versions = self._groups.get(manifest.gof_of(frame)) if frame < manifest.frames else None
        if versions is not None and self._library.tile_map(frame).has((frame, tile)):
            if self._kind(frame, tile) == TileKind.UPDATE:
                self.settled(frame, tile, delivered=False)
            number = self._number(frame, tile)
            for version in (versions.arrived, versions.sent):
                version[version == number] = -1
            self._changed(versions)

    def frames(self, at: int, frame: int, tile: int) -> float:
        """Frames for which the splats of a tile of looks will have been stale when frame ``at`` is displayed, in the
        mean.

        1 at least: the tile is the next version of what the client holds.
        """
        ids = self._library.tile_ids(frame, tile)
        versions = self._of(frame)
        if not len(ids) or versions is None:
            return 1.0
        tiles, shown = self._library.tile_map(frame), versions.sent[ids]
        # What was shown before a group begins is of the frame before it, at best.
        since = np.where(shown >= 0, tiles.frames[shown], tiles.start - 1)
        return max(at - float(since.mean()), 1.0)

    def share_shown(self, frame: int, tile: int) -> float:
        """Share of the splats of a tile of looks that the client shows in some version of this group of frames."""
        ids = self._library.tile_ids(frame, tile)
        versions = self._of(frame)
        if not len(ids) or versions is None:
            return 1.0
        return float((versions.sent[ids] >= 0).mean())

    def motion_frames(self, at: int, frame: int, tile: int, inventory: ClientInventory) -> float:
        """Frames for which what a chunk of motion moves will have stood still when frame ``at`` is displayed; 1 at
        least.

        The chunk that the client follows holds at its end, which is right until the next one begins.
        """
        tiles = self._library.tile_map(frame)
        number = tiles.number(frame, tile)
        since = frame
        for chunk in tiles.chunks_until(int(tiles.looks[number]), frame):
            if chunk != number and inventory.depth(*tiles.key(chunk)):
                break
            since = int(tiles.frames[chunk])
        return float(max(at - since, 1))

    def update_frames(self, at: int, frame: int, tile: int) -> float:
        """Frames for which the splats of an update that was not sent will have lacked updates when frame ``at`` is
        displayed, that of the update included, in the mean; 1 at least.

        A splat lacks them from the first on that was asked for here since anything newer of it was sent.
        """
        ids, versions = self._library.tile_ids(frame, tile), self._of(frame)
        if not len(ids) or versions is None:
            return float(max(at + 1 - frame, 1))
        lacked = versions.lacked[ids] = np.minimum(versions.lacked[ids], frame)
        return max(at + 1 - float(lacked.mean()), 1.0)

    def _number(self, frame: int, tile: int) -> int:
        return self._library.tile_map(frame).number(frame, tile)

    def _kind(self, frame: int, tile: int) -> TileKind:
        return self._library.entry(frame).tiles[tile].kind

    def _of(self, frame: int) -> _Versions | None:
        """Those of the group of ``frame``, which begins if it is entered for the first time; None if it is past."""
        manifest = self._library.manifest
        group = manifest.gof_of(frame)
        if group not in self._groups and (manifest.kept_whole or group > self._entered):
            self._entered = group
            if not manifest.kept_whole:
                self._groups = {number: kept for number, kept in self._groups.items() if number == group - 1}
            arrived = np.full(manifest.capacity[group], -1, np.int32)
            for key in self._held_of(group):
                ids = self._library.tile_ids(*key)
                arrived[ids] = np.maximum(arrived[ids], self._number(*key))
            updated = manifest.capacity[group] if self._library.tile_map(frame).has_updates else 0
            self._groups[group] = _Versions(arrived, arrived.copy(), np.full(updated, NOTHING, np.int32))
            self._changed(self._groups[group])
        return self._groups.get(group)

    def _changed(self, versions: _Versions) -> None:
        self._changes += 1
        versions.number = self._changes

    def _held_of(self, gof: int) -> list[tuple[int, int]]:
        frames = self._library.manifest.gof_frames(gof)
        there = [key for key in self._claimed if key[0] in frames and self._library.tile_map(key[0]).has(key)]
        return [key for key in there if self._kind(*key) == TileKind.LOOKS]
