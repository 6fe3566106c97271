"""Differential frames against what the decoder holds.

A splat is sent again when drawing the decoder's copy differs visibly more from the truth than a freshly quantised one
would. Since the comparison is with the decoder's copy and never with the frame before, slow changes add up until they
are sent: nothing drifts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common.attributes import join_attributes
from cags_common.bundle import SourceDelta, TilePayloads
from cags_common.morton import morton_order
from cags_common.splats import Ids, Splats
from cags_common.tiles import DELTA_TILE_SPLATS, KEY_TILE_SPLATS
from cags_encoder.frames.effect import visible_effect
from cags_encoder.frames.rows import SplatTable
from cags_encoder.frames.tiling import CodedSplats, Tiler


@dataclass(frozen=True, eq=False)
class DifferentialFrame:
    """One frame as it is stored."""

    tiles: tuple[TilePayloads, ...]
    removed: Ids  # [r] ascending
    source: SourceDelta
    sent: int
    """Splats in the tiles."""


class GofEncoder:
    """Encodes the frames of one group in order. The first frame given is the key frame."""

    def __init__(self, tiler: Tiler, change_threshold: float) -> None:
        self._tiler, self._threshold = tiler, change_threshold
        self._held: SplatTable | None = None
        self._source: SplatTable | None = None
        self._considered: SplatTable | None = None
        self._identities: NDArray[np.int64] = np.zeros(0, np.int64)
        self._free: list[int] = []

    @property
    def capacity(self) -> int:
        """One more than the largest id so far."""
        return self._held.capacity if self._held else 0

    def encode(self, splats: Splats, identities: NDArray[np.int64]) -> DifferentialFrame:
        """Encode the next frame, whose rows have persistent ``identities`` [n]."""
        if self._held is None or self._source is None or self._considered is None:
            return self._key_frame(splats, identities)
        return self._later_frame(splats, identities, self._held, self._source, self._considered)

    def _key_frame(self, splats: Splats, identities: NDArray[np.int64]) -> DifferentialFrame:
        order = morton_order(splats.means)
        splats, self._identities = splats.take(order), identities[order]
        ids = np.arange(len(splats), dtype=np.int32)
        frame = self._tiler.encode(self._coded(ids, splats), KEY_TILE_SPLATS, id_range=True)
        self._held = SplatTable(frame.decoded)
        self._source, self._considered = SplatTable(splats), SplatTable(splats)
        nobody = np.zeros(0, np.int32)
        return DifferentialFrame(frame.tiles, nobody, SourceDelta(ids, splats, nobody), len(ids))

    def _later_frame(
        self,
        splats: Splats,
        identities: NDArray[np.int64],
        held: SplatTable,
        source: SplatTable,
        considered: SplatTable,
    ) -> DifferentialFrame:
        ids, removed = self._place(identities, held)
        order = np.argsort(ids, kind="stable")
        ids, splats = ids[order], splats.take(order)
        fresh = ~held.holds(ids)
        differing = source.differs(ids, splats) | fresh
        for table in (held, source, considered):
            table.alive[removed] = False
        delta = SourceDelta(ids[differing], splats.take(differing), removed)
        source.put(delta.ids, delta.splats)
        # A splat whose source is what it was when it was last weighed needs no second look.
        candidates = considered.differs(ids, splats) | fresh
        considered.put(ids[candidates], splats.take(candidates))
        coded = self._coded(ids[candidates], splats.take(candidates))
        worth = fresh[candidates] | self._worth_sending(coded, splats.take(candidates), held)
        frame = self._tiler.encode(coded.take(np.flatnonzero(worth)), DELTA_TILE_SPLATS, id_range=False)
        held.put(frame.ids, frame.decoded)
        return DifferentialFrame(frame.tiles, removed, delta, len(frame.ids))

    def _coded(self, ids: Ids, splats: Splats) -> CodedSplats:
        return CodedSplats(ids, splats.means, self._tiler.quantiser.encode(splats))

    def _worth_sending(self, coded: CodedSplats, true: Splats, held: SplatTable) -> NDArray[np.bool_]:
        """Whether quantising anew is visibly nearer to the truth than what the decoder holds; False for unknown ids."""
        out = held.holds(coded.ids)
        rows = np.flatnonzero(out)
        known, true = coded.take(rows), true.take(rows)
        renewed = join_attributes(true.means, self._tiler.quantiser.decode(known.codes))
        now, then = visible_effect(held.take(known.ids), true), visible_effect(renewed, true)
        out[rows] = now > then + self._threshold
        return out

    def _place(self, identities: NDArray[np.int64], held: SplatTable) -> tuple[Ids, Ids]:
        """Ids of this frame's rows (known ones keep theirs, new ones take free or fresh ids), and the ids that went."""
        lookup = np.argsort(self._identities, kind="stable")
        at = np.searchsorted(self._identities, identities, sorter=lookup)
        at = lookup[np.minimum(at, len(lookup) - 1)]
        known = self._identities[at] == identities
        gone = held.alive.copy()
        gone[at[known]] = False
        removed = np.flatnonzero(gone).astype(np.int32)
        ids = at.astype(np.int32)
        new = np.flatnonzero(~known)
        ids[new] = self._fresh_ids(len(new))
        top = max(len(self._identities), int(ids.max(initial=-1)) + 1)
        self._identities = np.concatenate([self._identities, np.full(top - len(self._identities), -1)])
        self._identities[removed] = -1
        self._identities[ids] = identities
        self._free = sorted({*self._free, *removed.tolist()})
        return ids, removed

    def _fresh_ids(self, count: int) -> Ids:
        """Ids that went in earlier frames first (never in this one: a client may apply its removals late)."""
        reused, self._free = self._free[:count], self._free[count:]
        first = len(self._identities)
        fresh = range(first, first + count - len(reused))
        return np.array([*reused, *fresh], np.int32)
