"""Differential frames against what the decoder holds.

A splat is sent again when drawing the decoder's copy differs visibly more from the truth than a freshly quantised one
would. Since the comparison is with the decoder's copy and never with the frame before, slow changes add up until they
are sent: nothing drifts.

Only two small steps depend on earlier frames: which ids a frame's splats get (:class:`Placer`), and which of the
changed ones are worth sending (:class:`DecoderCopy`). What costs time lies between and after them and depends on one
frame alone, so that frames are quantised and packed in parallel (:mod:`cags_encoder.frames.tasks`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle import SourceDelta
from cags_common.geometry import F64
from cags_common.morton import morton_order
from cags_common.splats import Ids, Splats
from cags_common.tiles import DELTA_TILE_SPLATS, KEY_TILE_SPLATS
from cags_encoder.codecs import ClipCodec, CodedSplats
from cags_encoder.frames.effect import visible_effect
from cags_encoder.frames.rows import SplatTable
from cags_encoder.frames.tiling import CutTile, cut_tiles


class Placer:
    """Gives the splats of one group's frames their ids, in order. The first frame given is the key frame."""

    def __init__(self) -> None:
        self._table: SplatTable | None = None
        self._identities: NDArray[np.int64] = np.zeros(0, np.int64)
        self._free: list[int] = []

    @property
    def capacity(self) -> int:
        """One more than the largest id so far."""
        return self._table.capacity if self._table else 0

    def place(self, splats: Splats, identities: NDArray[np.int64]) -> SourceDelta:
        """What the next frame [n], n >= 1, changes: its rows have persistent ``identities`` [n]."""
        if self._table is None:
            order = morton_order(splats.means)
            splats, self._identities = splats.take(order), identities[order]
            self._table = SplatTable(splats)
            return SourceDelta(np.arange(len(splats), dtype=np.int32), splats, np.zeros(0, np.int32))
        ids, removed = self._ids(identities, self._table.alive)
        order = np.argsort(ids, kind="stable")
        ids, splats = ids[order], splats.take(order)
        differing = self._table.differs(ids, splats) | ~self._table.holds(ids)
        self._table.alive[removed] = False
        delta = SourceDelta(ids[differing], splats.take(differing), removed)
        self._table.put(delta.ids, delta.splats)
        return delta

    def _ids(self, identities: NDArray[np.int64], alive: NDArray[np.bool_]) -> tuple[Ids, Ids]:
        """Ids of this frame's rows (known ones keep theirs, new ones take free or fresh ids), and the ids that went."""
        lookup = np.argsort(self._identities, kind="stable")
        at = np.searchsorted(self._identities, identities, sorter=lookup)
        at = lookup[np.minimum(at, len(lookup) - 1)]
        known = self._identities[at] == identities
        gone = alive.copy()
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


@dataclass(frozen=True, eq=False)
class QuantisedDelta:
    """A frame's changed splats [n], quantised afresh."""

    prepared: Splats
    """The truth, in the form that the codec gives back."""
    coded: CodedSplats
    effect: F64 | None
    """Visible effect [n] that quantisation alone has; None in key frames, which send everything."""
    source: bytes
    """The unquantised changes, packed."""


@dataclass(frozen=True, eq=False)
class Sent:
    """What a frame sends, and what a decoder then holds of it."""

    ids: Ids  # [m] tile by tile
    shown: Splats | None  # [m]; None for a frame that sends nothing
    tiles: tuple[CutTile, ...]


class DecoderCopy:
    """What a decoder with every LoD holds in one group of frames."""

    def __init__(self, codec: ClipCodec, change_threshold: float) -> None:
        self._codec, self._threshold = codec, change_threshold
        self._table: SplatTable | None = None

    def send(self, delta: SourceDelta, quantised: QuantisedDelta) -> Sent:
        """Choose and cut what the next frame sends, and take it over."""
        if quantised.effect is None:
            sent = self._cut(delta.ids, quantised, largest=KEY_TILE_SPLATS, id_range=True)
        else:
            rows = np.flatnonzero(self._worth_sending(delta.ids, quantised.prepared, quantised.effect))
            chosen = QuantisedDelta(quantised.prepared.take(rows), quantised.coded.take(rows), None, b"")
            sent = self._cut(delta.ids[rows], chosen, largest=DELTA_TILE_SPLATS, id_range=False)
        self.take(sent.ids, sent.shown, delta.removed)
        return sent

    def take(self, ids: Ids, shown: Splats | None, removed: Ids) -> None:
        """Hold ``shown`` [m] as ``ids`` and drop ``removed``."""
        if self._table is None:
            assert shown is not None  # a key frame holds at least one splat
            self._table = SplatTable(shown.take(np.argsort(ids, kind="stable")))
            return
        self._table.alive[removed] = False
        if shown is not None:
            self._table.put(ids, shown)

    def _worth_sending(self, ids: Ids, true: Splats, effect: F64) -> NDArray[np.bool_]:
        """Whether each splat is new, or its fresh copy visibly nearer to the truth than what the decoder holds."""
        assert self._table is not None
        known = self._table.holds(ids)
        worth = ~known
        held = visible_effect(self._table.take(ids[known]), true.take(known))
        worth[known] = held > effect[known] + self._threshold
        return worth

    def _cut(self, ids: Ids, quantised: QuantisedDelta, *, largest: int, id_range: bool) -> Sent:
        tiles = cut_tiles(ids, quantised.prepared.means, quantised.coded, largest=largest, id_range=id_range)
        if not tiles:
            return Sent(ids, None, ())
        shown = Splats.concatenate([self._codec.shown(tile.coded) for tile in tiles])
        return Sent(np.concatenate([tile.ids for tile in tiles]), shown, tiles)
