"""Tiles on their way to one client: what it holds, what it lacks, and the messages that bring it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle.codecs import WHOLE_TILES_CODEC
from cags_common.coding.packing import encode_ids
from cags_common.geometry import Camera
from cags_common.tiles.inventory import InventoryEntry
from cags_common.tiles.kinds import TileKind
from cags_protocol import events as ev
from cags_protocol.wire.messages import FrameEnd, TileLayers
from cags_server.ratecontrol import TileView, Upgrade
from cags_server.ratecontrol.priorities import (
    BASE_PRIORITY,
    ENHANCEMENT_PRIORITY,
    HIDDEN_PRIORITY,
    URGENT_PRIORITY,
)
from cags_server.scene.library import SceneLibrary
from cags_server.scene.tile_map import Numbers, TileMap
from cags_server.scene.visible_tiles import VisibleTile
from cags_server.visibility.age import VersionAge
from cags_server.visibility.bounds import opening_tiles
from cags_server.visibility.inventory import ClientInventory

Parts: TypeAlias = "tuple[list[ev.Outgoing], list[ev.Outgoing]]"
"""What comes new, and what makes better what is there."""


class TileSender:
    """Makes tile messages and keeps account of them."""

    def __init__(self, library: SceneLibrary, *, opening: bool) -> None:
        self._library, self._opening = library, opening
        self.layered = library.manifest.codec != WHOLE_TILES_CODEC
        self.inventory = ClientInventory(layered=self.layered)
        self.age = VersionAge(library)
        self.ended: int | None = None
        """Newest media frame whose end was queued."""
        self.from_nothing = False
        """Whether the client holds nothing and must be given a beginning."""
        self._late: list[tuple[int, int]] = []  # looks sent since the last end of a frame
        self.client_keeps = False
        """Whether the client holds on to what it has when it goes back within the clip, or the group of frames."""
        self._group: int | None = None  # of the frame ended last
        self.forgotten = False
        """Whether the client is to forget what it holds, and has not been told."""

    def resume(self, inventory: Iterable[InventoryEntry]) -> None:
        """The client still holds these tiles from an earlier session: they are not sent again."""
        tiles = [held for held in inventory if held.lods]
        for held in tiles:
            self.inventory.hold(held.frame, held.tile, held.lods)
        self.age.held((held.frame, held.tile) for held in tiles)

    def evicted(self, held: InventoryEntry) -> None:
        """The client keeps so many LoDs of a tile, for want of memory."""
        self.inventory.reduced(held.frame, held.tile, held.lods)
        if not held.lods:
            self.age.lost(held.frame, held.tile)

    def upgrades(self, frame: int, upgrades: tuple[Upgrade, ...], deadline_us: int) -> list[ev.Outgoing]:
        """Messages of a frame: new tiles and the ends of the frames that they are for, tiles that begin later, detail.

        Where several frames end at once, each does so as soon as what it needs is there.
        """
        base, detail = (self._layers if self.layered else self._whole_tiles)(upgrades, deadline_us)
        out: list[ev.Outgoing] = []
        for end in self.frame_ends(frame):
            assert isinstance(end.message, FrameEnd)
            now, base = _begun_by(end.message.frame, base)
            out += [*now, end]
        now, later = _begun_by(frame, base)
        return [*out, *now, *later, *detail]

    def beginning(self, frame: int, camera: Camera) -> list[ev.Outgoing]:
        """A picture from nothing, whatever the budget: base layers in view, the frame's end, the other base layers."""
        self.from_nothing = False
        in_view, hidden = opening_tiles(self._library, frame, camera) if self._opening else ([], [])
        lacking = [[key for key in keys if not self.inventory.holds(*key, 0)] for keys in (in_view, hidden)]
        out = [self._tile(key, (0, 1), BASE_PRIORITY) for key in lacking[0]]
        out += self.frame_ends(frame)
        return out + [self._tile(key, (0, 1), HIDDEN_PRIORITY) for key in lacking[1]]

    def _layers(self, upgrades: tuple[Upgrade, ...], deadline_us: int) -> Parts:
        """Base layers, which go ahead of everybody's detail, and the detail. A new tile whose first levels travel
        together counts as detail and comes first there, because the end of its frame does not wait for it.
        """
        fresh = [u for u in upgrades if u.from_lod == 0]
        base = [self._tile((u.frame, u.tile), (0, 1), BASE_PRIORITY, deadline_us) for u in fresh if u.together == 1]
        detail = [
            self._tile((u.frame, u.tile), run, URGENT_PRIORITY, deadline_us)
            for u in fresh
            if u.together > 1
            for run in self._missing_runs(u.frame, u.tile, 0, u.together)
        ]
        detail += [
            self._tile((u.frame, u.tile), run, URGENT_PRIORITY if u.urgent else ENHANCEMENT_PRIORITY, deadline_us)
            for u in sorted(upgrades, key=lambda u: u.from_lod > 0)
            for run in self._missing_runs(u.frame, u.tile, max(u.from_lod, u.together), u.to_lod)
        ]
        return base, detail

    def _whole_tiles(self, upgrades: tuple[Upgrade, ...], deadline_us: int) -> Parts:
        """New tiles, and tiles that are sent again at a better quality."""
        parts: Parts = [], []
        for u in upgrades:
            again = u.from_lod > 0
            priority = ENHANCEMENT_PRIORITY if again and not u.urgent else BASE_PRIORITY
            parts[again].append(self._tile((u.frame, u.tile), (u.to_lod - 1, u.to_lod), priority, deadline_us))
        return parts

    def enter(self, frame: int) -> None:
        """A new group of frames has ids of its own; a client forgets those before the one that it leaves, unless it
        keeps the clip whole, and one that keeps none forgets everything when the media starts again.
        """
        if self.ended is None:
            return
        manifest = self._library.manifest
        left, entered = manifest.gof_of(self.ended), manifest.gof_of(frame)
        if frame >= self.ended:
            if left != entered and not manifest.kept_whole:
                self.inventory.forget_before(self._library.gof_start(self.ended))
        elif self.client_keeps and (left == entered or manifest.kept_whole):
            self.ended = None
        else:
            self.start_anew()

    def go_on(self, frame: int) -> None:
        """The viewer pauses, or plays on at another speed, at ``frame``, which is on display or comes next: the client
        still holds everything, also of a group of frames that has been entered ahead of the display.
        """
        if self.ended is not None:
            self.ended = min(self.ended, frame)

    def jump(self, frame: int) -> None:
        """The viewer jumps to ``frame``: a client that keeps it still holds the clip, or the group of frames on
        display. That group is the one entered last, or the one before.
        """
        manifest, entered = self._library.manifest, self._group
        near = entered is not None and entered - 1 <= manifest.gof_of(frame) <= entered
        if self.client_keeps and (near or manifest.kept_whole):
            self.ended = None
        else:
            self.start_anew()

    def start_anew(self) -> None:
        """The client holds nothing any more."""
        self.inventory.clear()
        self.age.clear()
        self.ended = self._group = None
        self.from_nothing = self.forgotten = True

    def view(self, tile: VisibleTile, frame: int, lead_frames: float) -> TileView:
        """A tile that is visible at ``frame``, planned ``lead_frames`` before its display, as rate policies see it."""
        entry = self._library.entry(tile.frame)
        held = entry.tiles[tile.tile]
        sizes = held.lod_bytes
        depth = self.inventory.depth(tile.frame, tile.tile)
        above = self.inventory.mask(tile.frame, tile.tile) >> depth  # what is held beyond a gap
        if above:
            sizes = (*sizes[:depth], *(0 if above >> i & 1 else size for i, size in enumerate(sizes[depth:])))
        while 0 < depth < len(sizes) and not sizes[depth]:  # held, or of attributes that an update leaves as they are
            depth += 1
        return TileView(
            tile.frame,
            tile.tile,
            depth,
            tile.count,
            sizes,
            weight=tile.weight,
            frames_left=tile.frames_left,
            passing=tile.frames_left <= lead_frames,
            replaces=0.0 if entry.keyframe or depth else self.age.share_shown(tile.frame, tile.tile),
            stale_frames=1.0 if depth else self._stale_frames(tile, frame, keyframe=entry.keyframe),
            kind=tile.kind,
            motion_bytes=held.lod_bytes[0] / max(held.span, 1) if tile.kind == TileKind.MOTION else 0.0,
            after=tile.looks if tile.looks and not self.inventory.depth(*tile.looks) else None,
        )

    def _stale_frames(self, tile: VisibleTile, frame: int, *, keyframe: bool) -> float:
        """For how long what ``tile`` changes will have been out of date at ``frame``; 1 at least."""
        if tile.kind == TileKind.MOTION:
            return self.age.motion_frames(frame, tile.frame, tile.tile, self.inventory)
        if tile.kind == TileKind.UPDATE:
            return self.age.update_frames(frame, tile.frame, tile.tile)
        return 1.0 if keyframe else self.age.frames(frame, tile.frame, tile.tile)

    def settled(self, message: TileLayers, *, delivered: bool) -> None:
        """Layers have arrived, or will not."""
        (self.inventory.delivered if delivered else self.inventory.dropped)(message)
        if self._brings_version(message):
            self.age.settled(message.frame, message.tile, delivered=delivered)

    def _brings_version(self, message: TileLayers) -> bool:
        """Whether the splats of its frame come with ``message``; further layers refine what is there."""
        return message.from_lod == 0 or not self.layered

    def _missing_runs(self, frame: int, tile: int, first: int, end: int) -> list[tuple[int, int]]:
        """[first, end) without the layers that the client holds already, as half-open runs."""
        runs: list[tuple[int, int]] = []
        for lod in range(first, end):
            if self.inventory.holds(frame, tile, lod):
                continue
            if runs and runs[-1][1] == lod:
                runs[-1] = (runs[-1][0], lod + 1)
            else:
                runs.append((lod, lod + 1))
        return runs

    def _tile(
        self, key: tuple[int, int], lods: tuple[int, int], priority: int, deadline_us: int | None = None
    ) -> ev.Outgoing:
        """LoDs [first, end) of the tile (media frame, tile)."""
        reader, (first, end) = self._library.reader, lods
        entry = reader.frame(key[0]).tiles[key[1]]
        payload = b"".join(reader.payload(*key, lod) for lod in range(first, end))
        message = TileLayers(*key, first, end, entry.lod_bytes[first:end])
        self.inventory.queued(message)
        if self._brings_version(message):
            self.age.sent(message.frame, message.tile)
            self._late += [key] if entry.kind == TileKind.LOOKS else []
        return ev.Outgoing(message, payload, priority, deadline_us)

    def frame_ends(self, frame: int) -> list[ev.Outgoing]:
        """The ends of every frame up to ``frame`` that has not been ended: skipped ones too, for their removed ids."""
        first = self._library.gof_start(frame) if self.ended is None else self.ended + 1
        self.ended, self._group = frame, self._library.manifest.gof_of(frame)
        ends = [ev.Outgoing(FrameEnd(at), self._removed(at), BASE_PRIORITY) for at in range(first, frame + 1)]
        self._late = []
        return ends

    def _removed(self, frame: int) -> bytes:
        """The ids that end at ``frame``; where motion says when splats end, those of motion that the client lacks."""
        library = self._library
        if library.manifest.motion is None:
            return library.removed_payload(frame)
        ids, tiles = library.reader.removed_ids(frame), library.tile_map(frame)
        shown = self.age.shown_with(frame, [])[ids]
        older = np.flatnonzero((shown >= 0) & (tiles.frames[shown] < frame)) if len(ids) else np.zeros(0, np.intp)
        looks = np.flatnonzero(np.bincount(shown[older])).astype(np.int32)
        follows = np.zeros(len(tiles.frames), np.bool_)
        follows[looks] = self._follows(tiles, looks, frame)
        ends = np.zeros(len(library.owners(frame)), np.bool_)
        ends[ids[older[~follows[shown[older]]]]] = ends[self._ended_before(frame)] = True
        return encode_ids(np.flatnonzero(ends).astype(np.int32))

    def _ended_before(self, frame: int) -> NDArray[np.int32]:
        """Splats of looks that were sent of late, though they had ended before ``frame``."""
        late = [key for key in self._late if self._library.gof_start(frame) <= key[0] < frame]
        if not late:
            return np.zeros(0, np.int32)
        ids = np.concatenate([self._library.tile_ids(*key) for key in late])
        ended: NDArray[np.int32] = ids[self._library.owners(frame)[ids] < 0].astype(np.int32)
        return ended

    def _follows(self, tiles: TileMap, looks: Numbers, frame: int) -> NDArray[np.bool_]:
        """[m] whether the client has the motion that says what of ``looks`` [m] ends at ``frame``; what travels may
        drop.
        """
        delivered = np.zeros(len(looks), np.bool_)
        for at in (frame - 1, frame):
            chunks = tiles.chunk_at(looks, at).tolist()
            there = [n >= 0 and self.inventory.delivered_depth(*tiles.key(n)) > 0 for n in chunks]
            delivered |= np.array(there, np.bool_)
        return delivered


def _begun_by(frame: int, tiles: list[ev.Outgoing]) -> Parts:
    """Of ``tiles`` those that show in ``frame``, and those that begin later."""
    parts: Parts = [], []
    for each in tiles:
        parts[isinstance(each.message, TileLayers) and each.message.frame > frame].append(each)
    return parts
