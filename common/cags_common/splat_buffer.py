"""The splats of one group of frames, by id, merged from tiles: what a decoder shows at a time.

The rules, whatever the order in which tiles are written:

- the newest looks win, splat by splat (a tile of looks of a later frame holds whole splats);
- an enhancement layer changes only the splats that its own tile still owns;
- an update changes single attributes; the newest update of an attribute wins, until newer looks come;
- motion says where the splats that a tile of looks owns are, how they turn and fade, and when they end: by the newest
  chunk that begins at or before the time shown, held at its end until another is there;
- a removal at frame f ends splats of looks before f, and keeps late tiles of those from bringing them back.

Client, server and encoder use this class, so that each knows what another shows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32
from cags_common.motion.apply import ABSENT_LOGIT, Looks, Steps, evaluate
from cags_common.motion.chunk import Chunk
from cags_common.splats import SH_REST_OF_DEGREE, Ids, Splats
from cags_common.updates import UPDATE_COLUMNS

Key = tuple[int, int]
"""Media frame and tile."""

Rows = NDArray[np.intp]


@dataclass(eq=False)
class Slot:
    """One tile in a buffer: which rows it brought, and how many of them it still owns."""

    index: int
    key: Key
    owned: int = 0
    shown_lod: int = -1
    replaced: bool = False
    ids: Ids = field(default_factory=lambda: np.zeros(0, np.int32))
    """[n] in the tile's order."""
    steps: Steps | None = None
    """Units of the tile's motion; None where it never moves."""

    @property
    def frame(self) -> int:
        """Media frame that the tile is of."""
        return self.key[0]


class SplatBuffer:
    """Rows are splat ids. One thread writes; memory for ``capacity`` rows is taken when something is written."""

    def __init__(
        self,
        capacity: int,
        sh_degree: int,
        *,
        on_replaced: Callable[[Slot], None] = lambda slot: None,
        before_change: Callable[[int, Rows], None] = lambda frame, rows: None,
    ) -> None:
        """``on_replaced`` hears of each tile of which nothing is shown any more, ``before_change(frame, rows)`` of rows
        that are about to be replaced, removed or moved for media frame ``frame``.
        """
        self._capacity, self._sh_degree = capacity, sh_degree
        self._on_replaced, self._before_change = on_replaced, before_change
        self.improved = 0
        """Times that layers made splats better without a change of what they show."""
        self.slots: list[Slot] = []
        """Every tile that was added, by :attr:`Slot.index`."""
        self._by_key: dict[Key, Slot] = {}
        self._chunks: dict[Key, dict[int, Chunk]] = {}  # looks -> first frame -> motion
        self._moved_at: dict[Key, float] = {}
        self._dirty: set[Key] = set()

    @cached_property
    def splats(self) -> Splats:
        """Those on display; rows without a splat are absent (``ABSENT_LOGIT``)."""
        return _blank(self._capacity, self._sh_degree)

    @cached_property
    def _still(self) -> tuple[F32, F32, F32]:
        """Means, quaternions and opacity logits as looks and updates say them, before motion."""
        return self.splats.means.copy(), self.splats.quats.copy(), self.splats.logit_opacities.copy()

    def _unset(self) -> NDArray[np.int32]:
        return np.full(self._capacity, -1, np.int32)

    @cached_property
    def owner(self) -> NDArray[np.int32]:
        """[capacity] index of the tile of looks that a row is from; -1 where there is no splat."""
        return self._unset()

    @cached_property
    def _source(self) -> NDArray[np.int32]:
        """Media frame of the looks that a row is from."""
        return self._unset()

    @cached_property
    def _removed_at(self) -> NDArray[np.int32]:
        """The newest media frame that removed the row."""
        return self._unset()

    @cached_property
    def _updated(self) -> dict[str, NDArray[np.int32]]:
        """Column -> [capacity] media frame of the newest update of a row; -1 where looks are all there is."""
        return {column: self._unset() for column in UPDATE_COLUMNS}

    def add(self, slot: Slot) -> None:
        """Take a tile in, before anything of it is written; its index is ``len(self.slots)``."""
        self.slots.append(slot)
        self._by_key[slot.key] = slot

    def clear(self) -> None:
        """Back to no splats; the tiles stay, and their motion."""
        self.splats.logit_opacities[:] = ABSENT_LOGIT
        self._still[2][:] = ABSENT_LOGIT
        for rows in (self.owner, self._source, self._removed_at, *self._updated.values()):
            rows[:] = -1
        self._moved_at.clear()

    def remove(self, frame: int, ids: Ids) -> Ids:
        """End ``ids`` at media frame ``frame``; those that were shown until now."""
        self._removed_at[ids] = np.maximum(self._removed_at[ids], frame)
        gone: Ids = ids[self._source[ids] < frame]
        self._release(gone)
        self.owner[gone] = -1
        self._before_change(frame, gone.astype(np.intp))
        self.splats.logit_opacities[gone] = self._still[2][gone] = ABSENT_LOGIT
        return gone

    def write(self, slot: Slot, lod: int, ids: Ids, splats: Splats) -> Ids:
        """Show a tile of looks at ``lod``: ``splats`` [n] by ``ids`` [n]. The ids of those that are its to show."""
        slot.ids = ids
        mine = self.owner[ids] == slot.index
        newer = (self._source[ids] < slot.frame) & (self._removed_at[ids] <= slot.frame)
        claimed = ids[newer & ~mine]
        self._release(claimed)
        self.owner[claimed], self._source[claimed] = slot.index, slot.frame
        slot.owned += len(claimed)
        self._before_change(slot.frame, claimed.astype(np.intp))
        self.improved += bool(mine.any())
        write = np.nonzero(mine | newer)[0]
        rows: Ids = ids.take(write)
        self._put(rows, splats if len(write) == len(ids) else splats.take(write), slot.frame)
        slot.shown_lod = lod
        self._dirty.add(slot.key)
        if not slot.owned:
            self._on_replaced(slot)
        return rows

    def _put(self, rows: Ids, splats: Splats, frame: int) -> None:
        """Looks of media frame ``frame``; what newer updates changed stays."""
        targets = dict(self.splats.arrays())
        for name, values in splats.arrays():
            keep = self._updated[name][rows] > frame if name in self._updated else None
            if keep is not None and keep.any():
                targets[name][rows[~keep]] = values[~keep]
            else:
                targets[name][rows] = values
                if keep is not None:
                    self._updated[name][rows] = -1
        for still, name in zip(self._still, ("means", "quats", "logit_opacities"), strict=True):
            still[rows] = targets[name][rows]

    def update(self, frame: int, values: Mapping[str, tuple[Rows, F32]]) -> Rows:
        """Take an update of media frame ``frame``: column -> (ids [m], values [m, ...]); the rows that changed."""
        targets, changed = dict(self.splats.arrays()), [np.zeros(0, np.intp)]
        for column, (ids, rows) in values.items():
            newest = self._updated[column]
            takes = (newest[ids] <= frame) & (self._source[ids] <= frame) & (self._removed_at[ids] <= frame)
            taken = ids[takes]
            newest[taken] = frame
            shown = taken[self.owner[taken] >= 0]
            self._before_change(frame, shown)
            targets[column][taken] = rows[takes]
            if column == "logit_opacities":
                self._still[2][taken] = rows[takes]
                self.splats.logit_opacities[taken[self.owner[taken] < 0]] = ABSENT_LOGIT
            changed.append(shown)
        out = np.unique(np.concatenate(changed))
        self._dirty |= {self.slots[index].key for index in np.unique(self.owner[out]) if index >= 0}
        return out

    def set_motion(self, looks: Key, start: int, chunk: Chunk) -> None:
        """Take the motion of the splats of tile ``looks`` from media frame ``start`` on, or more of its levels."""
        self._chunks.setdefault(looks, {})[start] = chunk
        self._dirty.add(looks)

    def move(self, time: float) -> Rows:
        """Show every splat where it is at ``time`` (media frames); the rows that changed."""
        out = [np.zeros(0, np.intp)]
        for key, chunks in self._chunks.items():
            slot = self._by_key.get(key)
            if slot is None or not slot.owned or slot.steps is None or not chunks:
                continue
            start = max((first for first in chunks if first <= time), default=None)
            if start is None:
                continue
            if self._settled(key, time, start + chunks[start].span):
                continue
            out.append(self._move(slot, chunks[start], time, start))
            self._moved_at[key] = time
        self._dirty.clear()
        return np.concatenate(out)

    def _settled(self, key: Key, time: float, end: float) -> bool:
        """Whether a tile is shown as it is at ``time`` already: nothing new, and its motion at its end or as it was."""
        before = self._moved_at.get(key)
        return key not in self._dirty and before is not None and (before == time or (before >= end and time >= end))

    def _move(self, slot: Slot, chunk: Chunk, time: float, start: int) -> Rows:
        assert slot.steps is not None
        mine = np.flatnonzero(self.owner[slot.ids] == slot.index)
        rows: Rows = slot.ids[mine].astype(np.intp)
        still = Looks(*(array[slot.ids] for array in self._still))
        moved = evaluate(chunk, time - start, still, slot.steps)
        self._before_change(int(time), rows)
        self.splats.means[rows] = moved.means[mine]
        self.splats.quats[rows] = moved.quats[mine]
        self.splats.logit_opacities[rows] = moved.logit_opacities[mine]
        return rows

    def _release(self, rows: Ids) -> None:
        """These rows leave the tiles that own them."""
        owners = self.owner[rows]
        counts = np.bincount(owners[owners >= 0], minlength=0)
        for index in np.nonzero(counts)[0]:
            slot = self.slots[index]
            slot.owned -= int(counts[index])
            if not slot.owned:
                self._on_replaced(slot)


def _blank(capacity: int, sh_degree: int) -> Splats:
    quats = np.zeros((capacity, 4), np.float32)
    quats[:, 0] = 1.0
    zeros = np.zeros((capacity, 3), np.float32)
    rest = np.zeros((capacity, SH_REST_OF_DEGREE[sh_degree], 3), np.float32)
    return Splats(zeros, quats, zeros - 10, np.full(capacity, ABSENT_LOGIT), zeros.copy(), rest)
