"""Differential frames relative to the decoder's copy.

A splat is sent again if the decoder's copy of it is visibly worse than a freshly quantised one. The comparison is with
the decoder's copy, never with the previous frame, so slow changes add up until they are sent, and nothing drifts.

Only two small steps depend on earlier frames: the assignment of ids (:mod:`cags_encoder.tracks.placing`), and the
choice of the changes that are worth sending (:class:`DecoderCopy`). The expensive steps, quantisation and packing,
depend on one frame alone and run in parallel (:mod:`cags_encoder.frames.tasks`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle import SourceDelta
from cags_common.geometry import F64
from cags_common.splats import Ids, Splats
from cags_common.tiles.payloads import DELTA_TILE_SPLATS, KEY_TILE_SPLATS
from cags_encoder.codecs.registry import ClipCodec, CodedSplats
from cags_encoder.tiling import CutTile, cut_tiles
from cags_encoder.tracks.effect import visible_effect
from cags_encoder.tracks.rows import SplatTable


@dataclass(frozen=True, eq=False)
class QuantisedDelta:
    """A frame's changed splats [n], freshly quantised."""

    prepared: Splats
    """The true splats in the codec's form (see ``prepare``)."""
    coded: CodedSplats
    effect: F64 | None
    """Visible effect [n] of quantisation alone; None in key frames, which send everything."""
    source: bytes
    """The packed unquantised changes."""


class DecoderCopy:
    """The splats that a decoder with every LoD holds, in one group of frames."""

    def __init__(self, codec: ClipCodec, change_threshold: float) -> None:
        self._codec, self._threshold = codec, change_threshold
        self._table: SplatTable | None = None

    def send(self, delta: SourceDelta, quantised: QuantisedDelta) -> tuple[CutTile, ...]:
        """Choose and cut the tiles of the next frame, and update the copy."""
        if quantised.effect is None:
            tiles = self._cut(delta.ids, quantised, largest=KEY_TILE_SPLATS, id_range=True)
        else:
            rows = np.flatnonzero(self._worth_sending(delta.ids, quantised.prepared, quantised.effect))
            chosen = QuantisedDelta(quantised.prepared.take(rows), quantised.coded.take(rows), None, b"")
            tiles = self._cut(delta.ids[rows], chosen, largest=DELTA_TILE_SPLATS, id_range=False)
        if self._table is not None:
            self._table.alive[delta.removed] = False
        for tile in tiles:
            self._hold(tile.ids, self._codec.shown(tile.coded))
        return tiles

    def _hold(self, ids: Ids, shown: Splats) -> None:
        if self._table is None:
            self._table = SplatTable(shown.take(slice(0, 0)))
        self._table.put(ids, shown)

    def _worth_sending(self, ids: Ids, true: Splats, effect: F64) -> NDArray[np.bool_]:
        """Which splats are new, or would be visibly closer to the truth if sent again."""
        assert self._table is not None
        known = self._table.holds(ids)
        worth = ~known
        held = visible_effect(self._table.take(ids[known]), true.take(known))
        worth[known] = held > effect[known] + self._threshold
        return worth

    @staticmethod
    def _cut(ids: Ids, quantised: QuantisedDelta, *, largest: int, id_range: bool) -> tuple[CutTile, ...]:
        return cut_tiles(ids, quantised.prepared.means, quantised.coded, largest=largest, id_range=id_range)
