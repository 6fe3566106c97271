"""The splats on display of one group of frames, merged from tiles splat by splat.

The rules, whatever the order in which tiles are written:

- the newest source frame wins, splat by splat (a tile of a later frame holds whole splats);
- an enhancement layer changes only the splats that its own tile still owns;
- a removal at frame f ends splats of source frames before f, and keeps late tiles of those from bringing them back.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cags_client.past import SplatPast
from cags_client.shown import Held, Shown
from cags_common.splats import SH_REST_OF_DEGREE, Ids, Splats

ABSENT_LOGIT = np.float32(-30.0)
"""Opacity logit of a row without a splat: drawn opacity 1e-13, which every rasteriser culls."""


class MergedSplats:
    """Rows are splat ids. One thread writes, another may add tiles meanwhile.

    Memory for ``capacity`` rows is taken when the group is first shown: one that only arrives costs what came of it.
    """

    def __init__(self, capacity: int, sh_degree: int, past: SplatPast, on_replaced: Callable[[Held], None]) -> None:
        """``past`` is told what is about to change; ``on_replaced`` hears of each tile of which nothing is shown."""
        self._capacity, self._sh_degree = capacity, sh_degree
        self.past = past
        self.improved = 0
        """Times that layers made splats better without a change of what they show."""
        self.tiles: list[Held] = []
        """Every tile that was added, by :attr:`Held.index`."""
        self._on_replaced = on_replaced

    @cached_property
    def splats(self) -> Splats:
        """Those on display; rows without a splat are absent (:data:`ABSENT_LOGIT`)."""
        quats = np.zeros((self._capacity, 4), np.float32)
        quats[:, 0] = 1.0
        zeros = np.zeros((self._capacity, 3), np.float32)
        rest = np.zeros((self._capacity, SH_REST_OF_DEGREE[self._sh_degree], 3), np.float32)
        return Splats(zeros, quats, zeros - 10, np.full(self._capacity, ABSENT_LOGIT), zeros.copy(), rest)

    def _unset(self) -> NDArray[np.int32]:
        return np.full(self._capacity, -1, np.int32)

    @cached_property
    def _owner(self) -> NDArray[np.int32]:
        """Index of the tile that a row is from."""
        return self._unset()

    @cached_property
    def _source(self) -> NDArray[np.int32]:
        """The source frame that a row is from."""
        return self._unset()

    @cached_property
    def _removed_at(self) -> NDArray[np.int32]:
        """The newest source frame that removed the row."""
        return self._unset()

    @property
    def shown(self) -> Shown:
        """What is on display."""
        return Shown(self._owner, tuple(self.tiles))

    def clear(self) -> None:
        """Back to no splats; the tiles stay."""
        self.splats.logit_opacities[:] = ABSENT_LOGIT
        for rows in (self._owner, self._source, self._removed_at):
            rows[:] = -1

    def remove(self, frame: int, ids: Ids) -> Ids:
        """End ``ids`` at source frame ``frame``; those that were shown until now."""
        self._removed_at[ids] = np.maximum(self._removed_at[ids], frame)
        gone: Ids = ids[self._source[ids] < frame]
        self._release(gone)
        self._owner[gone] = -1
        self.past.record(frame, gone, self.splats)
        self.splats.logit_opacities[gone] = ABSENT_LOGIT
        return gone

    def write(self, held: Held, lod: int, ids: Ids, splats: Splats) -> Ids:
        """Show a tile at ``lod``: ``splats`` [n] by ``ids`` [n]. The ids of those that are its to show."""
        mine = self._owner[ids] == held.index
        newer = (self._source[ids] < held.frame) & (self._removed_at[ids] <= held.frame)
        claimed = ids[newer & ~mine]
        self._release(claimed)
        self._owner[claimed], self._source[claimed] = held.index, held.frame
        held.owned += len(claimed)
        self.past.record(held.frame, claimed, self.splats)
        self.improved += bool(mine.any())
        write = np.nonzero(mine | newer)[0]
        rows: Ids = ids.take(write)
        chosen = splats if len(write) == len(ids) else splats.take(write)
        for (_, target), (_, values) in zip(self.splats.arrays(), chosen.arrays(), strict=True):
            target[rows] = values
        held.shown_lod = lod
        if not held.owned:
            self._on_replaced(held)
        return rows

    def _release(self, rows: Ids) -> None:
        """These rows leave the tiles that own them."""
        owners = self._owner[rows]
        counts = np.bincount(owners[owners >= 0], minlength=0)
        for index in np.nonzero(counts)[0]:
            held = self.tiles[index]
            held.owned -= int(counts[index])
            if not held.owned:
                self._on_replaced(held)
