"""Differential frames against what the decoder holds.

A splat is sent again when drawing the decoder's copy differs visibly more from the truth than a freshly quantised one
would. Since the comparison is with the decoder's copy and never with the frame before, slow changes add up until they
are sent: nothing drifts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle import SourceDelta, TilePayloads
from cags_common.morton import morton_order
from cags_common.splats import Ids, Splats
from cags_common.tiles import DELTA_TILE_SPLATS, KEY_TILE_SPLATS
from cags_encoder.codecs import ClipCodec
from cags_encoder.frames.effect import visible_effect
from cags_encoder.frames.rows import SplatTable
from cags_encoder.frames.tiling import TiledFrame, encode_tiles


@dataclass(frozen=True, eq=False)
class DifferentialFrame:
    """One frame as it is stored."""

    tiles: tuple[TilePayloads, ...]
    removed: Ids  # [r] ascending
    source: SourceDelta
    sent: int
    """Splats in the tiles."""


@dataclass(frozen=True, eq=False)
class _Tables:
    """What is known by id."""

    held: SplatTable
    """What a decoder with every LoD holds."""
    source: SplatTable
    """The frame before, unquantised."""
    considered: SplatTable
    """The unquantised splat that was last compared with what the decoder holds."""

    def bury(self, ids: Ids) -> None:
        """Mark ``ids`` as gone."""
        for table in (self.held, self.source, self.considered):
            table.alive[ids] = False


class GofEncoder:
    """Encodes the frames of one group in order. The first frame given is the key frame."""

    def __init__(self, codec: ClipCodec, change_threshold: float) -> None:
        self._codec, self._threshold = codec, change_threshold
        self._tables: _Tables | None = None
        self._identities: NDArray[np.int64] = np.zeros(0, np.int64)
        self._free: list[int] = []

    @property
    def capacity(self) -> int:
        """One more than the largest id so far."""
        return self._tables.held.capacity if self._tables else 0

    def encode(self, splats: Splats, identities: NDArray[np.int64]) -> DifferentialFrame:
        """Encode the next frame [n], n >= 1, whose rows have persistent ``identities`` [n]."""
        if self._tables is None:
            return self._key_frame(splats, identities)
        return self._later_frame(splats, identities, self._tables)

    def _key_frame(self, splats: Splats, identities: NDArray[np.int64]) -> DifferentialFrame:
        order = morton_order(splats.means)
        splats, self._identities = splats.take(order), identities[order]
        ids = np.arange(len(splats), dtype=np.int32)
        coded = self._codec.quantise(self._codec.prepare(splats))
        frame = encode_tiles(self._codec, ids, splats.means, coded, largest=KEY_TILE_SPLATS, id_range=True)
        held = SplatTable(splats)
        if frame.decoded is not None:
            held.put(frame.ids, frame.decoded)
        self._tables = _Tables(held, SplatTable(splats), SplatTable(splats))
        nobody = np.zeros(0, np.int32)
        return DifferentialFrame(frame.tiles, nobody, SourceDelta(ids, splats, nobody), len(ids))

    def _later_frame(self, splats: Splats, identities: NDArray[np.int64], tables: _Tables) -> DifferentialFrame:
        ids, removed = self._place(identities, tables.held)
        order = np.argsort(ids, kind="stable")
        ids, splats = ids[order], splats.take(order)
        fresh = ~tables.held.holds(ids)
        differing = tables.source.differs(ids, splats) | fresh
        tables.bury(removed)
        delta = SourceDelta(ids[differing], splats.take(differing), removed)
        tables.source.put(delta.ids, delta.splats)
        # A splat whose source is what it was when it was last weighed needs no second look.
        candidates = tables.considered.differs(ids, splats) | fresh
        tables.considered.put(ids[candidates], splats.take(candidates))
        frame = self._send(ids[candidates], splats.take(candidates), tables.held)
        return DifferentialFrame(frame.tiles, removed, delta, len(frame.ids))

    def _send(self, ids: Ids, splats: Splats, held: SplatTable) -> TiledFrame:
        """Tile those of the splats that are new or worth sending, and note what the decoder then holds."""
        prepared = self._codec.prepare(splats)
        coded = self._codec.quantise(prepared)
        known = held.holds(ids)
        worth = ~known
        renewed = self._codec.decode(coded).take(known)
        worth[known] = self._worth_sending(held.take(ids[known]), renewed, prepared.take(known))
        rows = np.flatnonzero(worth)
        chosen = ids[rows], prepared.means[rows], coded.take(rows)
        frame = encode_tiles(self._codec, *chosen, largest=DELTA_TILE_SPLATS, id_range=False)
        if frame.decoded is not None:
            held.put(frame.ids, frame.decoded)
        return frame

    def _worth_sending(self, held: Splats, renewed: Splats, true: Splats) -> NDArray[np.bool_]:
        """Whether ``renewed`` [n] are visibly nearer to the truth than what the decoder holds."""
        worth: NDArray[np.bool_] = visible_effect(held, true) > visible_effect(renewed, true) + self._threshold
        return worth

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
