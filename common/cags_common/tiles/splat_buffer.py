"""The splats of one group of frames by id, combined from tiles: the state that a decoder shows at a time.

The result does not depend on the order in which tiles are written. Rules:

- For each splat the newest looks apply (tiles of looks contain whole splats). If two tiles of one frame contain the
  same splat, the tile with the lower number applies.
- An enhancement layer changes only the splats that its tile still owns.
- An update changes single attributes, at once or in a ramp (:mod:`cags_common.tiles.ramps`). The newest update of an
  attribute applies until looks of a later frame arrive (two updates of one frame never change the same attribute of a
  splat). A ramp begins at the value of the newest update before it, or of the looks.
- Motion sets position, rotation, fade and end of the splats that a tile of looks owns. The newest chunk that begins at
  or before the displayed time applies, and is held at its end until another arrives.
- A removal at frame f ends splats of looks before f, and prevents late tiles from restoring them.

Client, server and encoder use this class, so each can predict the others' state.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.ma
from numpy.typing import NDArray

from cags_common.geometry import F32
from cags_common.motion.apply import ABSENT_LOGIT, Looks, MovingTile, Steps, move_rows
from cags_common.motion.chunk import Chunk
from cags_common.motion.knots import I32
from cags_common.splats import SH_REST_OF_DEGREE, Ids, Splats
from cags_common.tiles.ramps import Ramps
from cags_common.tiles.updates import RAMP_COLUMNS, UPDATE_COLUMNS, Change

Key = tuple[int, int]
"""Media frame and tile."""

Rows = NDArray[np.intp]

MOVING_COLUMNS = ("means", "quats", "logit_opacities")
"""Columns of splats that motion changes."""


@dataclass(eq=False)
class Slot:
    """One tile of looks in a buffer: its rows, and the number that it still owns."""

    index: int
    key: Key
    owned: int = 0
    shown_lod: int = -1
    replaced: bool = False
    ended: bool = False
    """Whether all its splats have ended at the displayed time."""
    ids: Ids = field(default_factory=lambda: np.zeros(0, np.int32))
    """[n] in the tile's order."""
    steps: Steps | None = None
    """Units of the tile's motion; None for a tile that never moves."""
    rows: I32 | None = None
    """[n] ids of the splats that the tile still owns, -1 for the others; None: to be recomputed."""
    lost: bool = False
    """Whether :attr:`rows` names splats that the tile does not own any more."""

    @property
    def frame(self) -> int:
        """Media frame of the tile."""
        return self.key[0]


@dataclass(eq=False)
class _Motion:
    """Received motion of one tile of looks."""

    chunks: dict[int, Chunk] = field(default_factory=dict)
    """First media frame -> motion from it on."""
    ends: dict[int, float] = field(default_factory=dict)
    """First media frame -> time from which that chunk changes nothing."""
    shown: tuple[int, float] | None = None
    """First frame of the displayed chunk, and the time; None if splats are at the place of their looks."""
    dirty: bool = True
    """Whether looks or motion arrived since :attr:`shown`."""
    updated: bool = False
    """Whether opacities of looks were updated since, so that those in motion must be evaluated again."""
    _tile: MovingTile | None = None

    def start(self, time: float) -> int | None:
        """First frame of the chunk to show at ``time``."""
        return max((first for first in self.chunks if first <= time), default=None)

    def tile_at(self, start: int, time: float, rows: I32, steps: Steps) -> MovingTile:
        """The splats of ``rows`` to evaluate at ``time``: all of them, or, if the same chunk is displayed, those in
        motion that have not ended. Recomputed only if something other than the time has changed.
        """
        chunk, tile = self.chunks[start], self._tile
        if tile is None or tile.chunk is not chunk or tile.rows is not rows or tile.steps is not steps:
            tile = self._tile = MovingTile(chunk, time - start, rows, steps)
        tile.time = time - start
        if self.shown is None or self.shown[0] != start or self.dirty:
            return tile
        return tile.in_motion(None if self.updated else self.shown[1] - start)

    def leave_out(self, rows: I32, those: NDArray[np.bool_]) -> None:
        """From now on ``rows`` [n], which :meth:`tile_at` is given, are without ``those`` [n]."""
        rows[those] = -1
        if self._tile is not None and self._tile.rows is rows:
            self._tile.leave_out(those)

    def release(self) -> None:
        """Free what is worked out for its evaluation."""
        self._tile = None

    def settled(self, start: int, time: float) -> bool:
        """Whether the chunk from ``start`` is already displayed as of ``time``."""
        if self.dirty or self.updated or self.shown is None or self.shown[0] != start:
            return False
        return self.shown[1] == time or min(self.shown[1], time) >= self.ends[start]


class SplatBuffer:
    """Rows are splat ids. One thread writes; memory for ``capacity`` rows is allocated at the first write."""

    def __init__(
        self,
        capacity: int,
        sh_degree: int,
        *,
        on_replaced: Callable[[Slot], None] = lambda slot: None,
        threads: int = 1,
    ) -> None:
        """``on_replaced`` is called for each tile that is no longer shown. Motion is evaluated on ``threads``."""
        self._capacity, self._sh_degree, self._threads = capacity, sh_degree, threads
        self._on_replaced = on_replaced
        self.slots: list[Slot] = []
        """Every tile of looks that was added, by :attr:`Slot.index`."""
        self._by_key: dict[Key, Slot] = {}
        self._motions: dict[Key, _Motion] = {}

    @cached_property
    def splats(self) -> Splats:
        """Displayed splats; rows without a splat are absent (``ABSENT_LOGIT``)."""
        return _blank(self._capacity, self._sh_degree)

    @cached_property
    def _still(self) -> dict[str, F32]:
        """Moving columns from looks and updates, before motion."""
        return {name: getattr(self.splats, name).copy() for name in MOVING_COLUMNS}

    def _unset(self) -> NDArray[np.int32]:
        return np.full(self._capacity, -1, np.int32)

    @cached_property
    def owner(self) -> NDArray[np.int32]:
        """[capacity] index of the tile of looks of each row; -1 for no splat."""
        return self._unset()

    @cached_property
    def _source(self) -> NDArray[np.int32]:
        """Media frame of the looks of each row."""
        return self._unset()

    @cached_property
    def _removed_at(self) -> NDArray[np.int32]:
        """The newest media frame that removed each row."""
        return self._unset()

    @cached_property
    def _updated(self) -> dict[str, NDArray[np.int32]]:
        """Column -> [capacity] media frame of the newest update of each row; -1 for none."""
        return {column: self._unset() for column in UPDATE_COLUMNS}

    @cached_property
    def _ramps(self) -> dict[str, Ramps]:
        """Column -> splats of which it is on its way to the value of the newest update."""
        return {column: Ramps(getattr(self.splats, column).shape[1:]) for column in RAMP_COLUMNS}

    @property
    def nbytes(self) -> int:
        """Memory of the rows written so far, bytes."""
        made = vars(self)
        arrays = [made[name] for name in ("owner", "_source", "_removed_at") if name in made]
        arrays += [array for name in ("_still", "_updated") for array in made.get(name, {}).values()]
        arrays += [array for _, array in made["splats"].arrays()] if "splats" in made else []
        return sum(held.nbytes for held in (*arrays, *made.get("_ramps", {}).values()))

    def release(self) -> None:
        """Free the rows, as if nothing had been written, but keep the tiles and their motion. :meth:`clear` before
        anything is written again.
        """
        for name in ("splats", "_still", "owner", "_source", "_removed_at", "_updated", "_ramps"):
            vars(self).pop(name, None)
        for motion in self._motions.values():
            motion.release()

    def add(self, slot: Slot) -> None:
        """Add a tile of looks before it is written; its index is ``len(self.slots)``."""
        self.slots.append(slot)
        self._by_key[slot.key] = slot

    def clear(self) -> None:
        """Remove all splats, but keep the tiles and their motion."""
        self.splats.logit_opacities[:] = self._still["logit_opacities"][:] = ABSENT_LOGIT
        for rows in (self.owner, self._source, self._removed_at, *self._updated.values()):
            rows[:] = -1
        for ramps in self._ramps.values():
            ramps.clear()
        for motion in self._motions.values():
            motion.shown, motion.dirty = None, True
        for slot in self.slots:
            slot.rows, slot.lost, slot.ended = None, False, False

    # ------------------------------------------------------------------------------------------------------------ looks

    def remove(self, frame: int, ids: Ids) -> Ids:
        """End ``ids`` at media frame ``frame``; returns those that were shown until now."""
        self._removed_at[ids] = np.maximum(self._removed_at[ids], frame)
        gone: Ids = ids[self._source[ids] < frame]
        self._release(gone)
        self.owner[gone] = -1
        self.splats.logit_opacities[gone] = ABSENT_LOGIT  # updates of splats that have not arrived are kept
        return gone

    def write(self, slot: Slot, lod: int, ids: Ids, splats: Splats) -> Ids:
        """Show a tile of looks at ``lod``: ``splats`` [n] by ``ids`` [n]. Returns the ids that the tile owns."""
        slot.ids, slot.rows, slot.lost = ids, None, False
        mine = self.owner[ids] == slot.index
        newer = (self._source[ids] < slot.frame) & (self._removed_at[ids] <= slot.frame)
        newer |= self._of_later_tiles(slot, ids)
        claimed = ids[newer & ~mine]
        self._release(claimed)
        self.owner[claimed], self._source[claimed] = slot.index, slot.frame
        slot.owned += len(claimed)
        write = np.nonzero(mine | newer)[0]
        rows: Ids = ids.take(write)
        self._put(slot, rows, splats if len(write) == len(ids) else splats.take(write))
        slot.shown_lod = lod
        if not slot.owned:
            self._on_replaced(slot)
        return rows

    def _of_later_tiles(self, slot: Slot, ids: Ids) -> NDArray[np.bool_]:
        """Mask of the ``ids`` shown from tiles of the same frame as ``slot`` with a higher number."""
        contested: NDArray[np.bool_] = (
            (self._source[ids] == slot.frame) & (self.owner[ids] >= 0) & (self.owner[ids] != slot.index)
        )
        if contested.any():
            tiles = np.array([self.slots[owner].key[1] for owner in self.owner[ids[contested]]])
            contested[contested] = tiles > slot.key[1]
        return contested

    def _put(self, slot: Slot, rows: Ids, splats: Splats) -> None:
        """Write looks of ``slot``; attributes changed by updates of its frame or later stay."""
        moving, targets = self._touch(slot), dict(self.splats.arrays())
        for name, values in splats.arrays():
            base = self._still.get(name, targets[name])
            keep = self._updated[name][rows] >= slot.frame if name in self._updated else None
            written = rows
            if keep is not None and keep.any():
                written = rows[~keep]
                _set_rows(base, written, values[~keep])
                if name in self._ramps:
                    self._ramps[name].stand_on(rows[keep], slot.frame, values[keep])
            else:
                _set_rows(base, rows, values)
            if keep is not None:
                self._updated[name][written] = -1
            if name in self._ramps:
                self._ramps[name].drop(written)
            if base is not targets[name] and not moving:
                _set_rows(targets[name], rows, base.take(rows, axis=0))

    def _touch(self, slot: Slot) -> bool:
        """Note a change of ``slot``; returns whether :meth:`move` will write its moving columns."""
        motion = self._motions.get(slot.key)
        if motion is None:
            return False
        motion.dirty = True
        return motion.shown is not None

    def _release(self, rows: Ids) -> None:
        """Remove these rows from the tiles that own them."""
        owners = self.owner[rows]
        counts = np.bincount(owners[owners >= 0], minlength=0)
        for index in np.nonzero(counts)[0]:
            slot = self.slots[index]
            slot.lost = True
            slot.owned -= int(counts[index])
            if not slot.owned:
                self._on_replaced(slot)

    # ---------------------------------------------------------------------------------------------------------- updates

    def update(self, frame: int, values: Mapping[str, Change], time: float) -> Rows:
        """Apply an update of media frame ``frame`` to what is shown at ``time`` (media frames): column -> change.
        Returns the changed rows. Ramps that ``time`` has not passed are shown by :meth:`ramp`.
        """
        changed = []
        for column, change in values.items():
            after = self._after(frame, change.ids)
            takes = after & (self._updated[column][change.ids] <= frame)
            taken = change
            if not takes.all():
                taken, rest = change.take(takes), change.take(after & ~takes)
                if column in self._ramps:
                    self._ramps[column].precede(rest.ids, frame, rest.values)
            self._change(frame, column, taken, time)
            changed.append(taken.ids)
        return self._shown(changed)

    def _change(self, frame: int, column: str, change: Change, time: float) -> None:
        """Take a change of media ``frame`` that is the newest of all its splats."""
        since = self._updated[column][change.ids]
        self._updated[column][change.ids] = frame
        target, ids, new = getattr(self.splats, column), change.ids, change.values
        if column in self._still:
            self._still[column][ids] = new
            owners = self.owner[ids]
            target[ids[owners >= 0]] = new[owners >= 0]  # splats in motion are evaluated again
            for index in np.flatnonzero(np.bincount(owners[owners >= 0])):
                if motion := self._motions.get(self.slots[index].key):
                    motion.updated = True
            return
        ramps = self._ramps[column]
        later = frame + change.frames.astype(np.int64) > time + 1
        if later.any():
            coming, at_once = (change, None) if later.all() else (change.take(later), ~later)
            before = since if at_once is None else since[later]
            shown = target.take(coming.ids, axis=0)
            ramps.take_over(coming.ids, frame, coming.frames, (shown, coming.values), before)
            if at_once is None:
                return
            ids, new = ids[at_once], new[at_once]
        ramps.drop(ids)
        _set_rows(target, ids, new)

    def ramp(self, time: float) -> list[tuple[Rows, NDArray[np.int32]]]:
        """Show attributes that are on their way as they are at ``time`` (media frames). Returns the changed rows, by
        column, and for each row the media frame of its update.
        """
        out = []
        for column, ramps in self._ramps.items():
            ids, values, began = ramps.at(time)
            _set_rows(getattr(self.splats, column), ids, values)
            shown = self.owner.take(ids) >= 0
            out.append((ids[shown], began[shown]))
        return out

    def _after(self, frame: int, ids: Rows) -> NDArray[np.bool_]:
        """Mask of the ``ids`` whose looks and end, if any, came at media ``frame`` or before."""
        after: NDArray[np.bool_] = (self._source[ids] <= frame) & (self._removed_at[ids] <= frame)
        return after

    def _shown(self, parts: Sequence[Rows]) -> Rows:
        """Union of the given ``parts``, ascending and without duplicates."""
        listed = np.sort(np.concatenate([np.zeros(0, np.intp), *parts]))  # np.unique takes three times as long
        once: Rows = listed[np.diff(listed, prepend=-1) > 0]
        return once[self.owner[once] >= 0]

    def uses(self, frame: int, ids_of: Mapping[str, Rows], *, shown: bool = False) -> bool:
        """Whether the update of ``frame`` of columns' ``ids_of`` is the newest for any splat that exists or may arrive,
        or a ramp begins at it; with ``shown``, for any splat at the displayed time.
        """
        for column, ids in ids_of.items():
            used = (self._updated[column][ids] == frame) & (self._removed_at[ids] <= frame)
            if column in self._ramps and self._ramps[column].follows(ids, frame):
                return True
            if shown:
                used &= (self.owner[ids] >= 0) & (self.splats.logit_opacities[ids] > ABSENT_LOGIT)
            if used.any():
                return True
        return False

    # ----------------------------------------------------------------------------------------------------------- motion

    def set_motion(self, looks: Key, start: int, chunk: Chunk) -> None:
        """Add motion of the splats of tile ``looks`` from media frame ``start`` on, or further levels of it."""
        motion = self._motions.setdefault(looks, _Motion())
        motion.chunks[start], motion.ends[start], motion.dirty = chunk, start + _ends(chunk), True

    def drop_motion(self, looks: Key) -> None:
        """Remove all motion of tile ``looks``."""
        self._motions.pop(looks, None)

    def drop_past(self, time: float) -> list[tuple[Key, int]]:
        """Forget chunks replaced by ``time``; returns each by its looks and first frame. Earlier times cannot be shown
        without them.
        """
        gone = []
        for looks, motion in self._motions.items():
            if len(motion.chunks) < 2 or (start := motion.start(time)) is None:
                continue
            for first in [f for f in motion.chunks if f < start]:
                del motion.chunks[first], motion.ends[first]
                gone.append((looks, first))
        return gone

    def moves(self, looks: Key) -> int | None:
        """First media frame of the chunk that moves tile ``looks`` at the displayed time; None for none."""
        motion = self._motions.get(looks)
        return None if motion is None or motion.shown is None else motion.shown[0]

    def move(self, time: float) -> Rows:
        """Move every splat to its place at ``time`` (media frames); returns the changed rows."""
        tiles: list[MovingTile] = []
        for looks, motion in self._motions.items():
            slot = self._by_key.get(looks)
            if slot is None or not slot.owned or slot.steps is None:
                continue
            start = motion.start(time)
            if start is None or motion.settled(start, time):
                continue
            if slot.rows is None:
                slot.rows = np.where(self.owner[slot.ids] == slot.index, slot.ids, -1).astype(np.int32)
            elif slot.lost:
                motion.leave_out(slot.rows, self.owner[slot.ids] != slot.index)
            slot.lost = False
            tiles.append(motion.tile_at(start, time, slot.rows, slot.steps))
            slot.ended = time >= motion.ends[start] and _ends_all(motion.chunks[start])
            motion.shown, motion.dirty, motion.updated = (start, time), False, False
        if not tiles:
            return np.zeros(0, np.intp)
        listed = np.concatenate([tile.rows for tile in tiles])
        rows: Rows = listed[listed >= 0].astype(np.intp)
        shown = Looks(*(getattr(self.splats, name) for name in MOVING_COLUMNS))
        move_rows(tiles, Looks(*self._still.values()), shown, self._threads)
        return rows


def _set_rows(array: F32, rows: NDArray[np.integer], values: F32) -> None:
    """``array[rows] = values``, with each row copied as one item, which takes half the time."""
    width = array[:1].nbytes
    if not width or not len(rows):
        return
    item = np.dtype((np.void, width))
    whole = array.reshape(len(array), -1).view(item)
    whole[rows] = np.ascontiguousarray(values).reshape(len(rows), -1).view(item)


def _ends_all(chunk: Chunk) -> bool:
    """Whether no splat of a chunk outlives its span."""
    return chunk.lives is not None and int(chunk.lives.max(initial=0)) <= chunk.span


def _ends(chunk: Chunk) -> float:
    """Frames after a chunk's first frame until nothing changes: the span, or the end of the last life."""
    if _ends_all(chunk):
        assert chunk.lives is not None
        return float(chunk.lives.max(initial=0))
    return float(chunk.span)


def _blank(capacity: int, sh_degree: int) -> Splats:
    quats = np.zeros((capacity, 4), np.float32)
    quats[:, 0] = 1.0
    zeros = np.zeros((capacity, 3), np.float32)
    rest = np.zeros((capacity, SH_REST_OF_DEGREE[sh_degree], 3), np.float32)
    return Splats(zeros, quats, zeros - 10, np.full(capacity, ABSENT_LOGIT), zeros.copy(), rest)
