"""Splats with codes to encoded tiles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cags_common.attributes import join_attributes
from cags_common.bundle import LodLayer, TilePayloads
from cags_common.geometry import F32, Vec3
from cags_common.morton import morton_order, tile_ranges
from cags_common.packing import U32
from cags_common.splats import Ids, Splats
from cags_common.tiles import PositionGrid, encode_base, encode_layer
from cags_encoder.quantiser.training import Quantiser


@dataclass(frozen=True, eq=False)
class CodedSplats:
    """Splats to be sent, quantised."""

    ids: Ids  # [n]
    means: F32  # [n, 3] true
    codes: dict[str, U32]  # attribute -> [n] codes of full length

    def take(self, rows: np.ndarray) -> CodedSplats:
        """The splats at ``rows``."""
        return CodedSplats(self.ids[rows], self.means[rows], {name: codes[rows] for name, codes in self.codes.items()})


@dataclass(frozen=True, eq=False)
class EncodedFrame:
    """The tiles of one frame, and what a decoder that has every layer makes of them."""

    tiles: tuple[TilePayloads, ...]
    ids: Ids  # [n] as tiled
    decoded: Splats  # [n]


@dataclass(frozen=True, eq=False)
class Tiler:
    """Cuts coded splats into tiles and encodes them."""

    quantiser: Quantiser
    lod_order: tuple[LodLayer, ...]
    position_bits: int

    def encode(self, splats: CodedSplats, largest: int, *, id_range: bool) -> EncodedFrame:
        """Encode ``splats`` in tiles of at most ``largest``.

        With ``id_range`` they are in Morton order already and their ids count up from 0; otherwise they are put in
        Morton order, cut, and sorted by id within each tile.
        """
        if not id_range:
            splats = splats.take(morton_order(splats.means))
        tiles, rows, means = [], [], []
        for first, end in tile_ranges(len(splats.ids), largest):
            run = np.arange(first, end)
            if not id_range:
                run = run[np.argsort(splats.ids[run], kind="stable")]
            part = splats.take(run)
            grid = PositionGrid.over(part.means, self.position_bits)
            tiles.append(self._tile(part, grid, id_range=id_range))
            rows.append(run)
            means.append(grid.dequantise(grid.quantise(part.means)))
        if not tiles:
            return EncodedFrame((), splats.ids, join_attributes(splats.means, self.quantiser.decode(splats.codes)))
        tiled = splats.take(np.concatenate(rows))
        decoded = join_attributes(np.concatenate(means), self.quantiser.decode(tiled.codes))
        return EncodedFrame(tuple(tiles), tiled.ids, decoded)

    def _tile(self, splats: CodedSplats, grid: PositionGrid, *, id_range: bool) -> TilePayloads:
        books = self.quantiser.books
        base = {name: books[name].layer(codes, 0) for name, codes in splats.codes.items()}
        payloads = [encode_base(splats.ids, splats.means, base, grid, id_range=id_range)]
        for item in self.lod_order:
            book = books[item.attribute]
            codes = book.layer(splats.codes[item.attribute], item.layer)
            payloads.append(encode_layer(codes, book.layer_bits[item.layer]))
        first_id = int(splats.ids[0]) if id_range else None
        return TilePayloads(len(splats.ids), first_id, corners(splats.means), tuple(payloads))


def corners(means: F32) -> tuple[Vec3, Vec3]:
    """Smallest and largest corner of points [n, 3], n >= 1."""
    low, high = means.min(axis=0).tolist(), means.max(axis=0).tolist()
    return (low[0], low[1], low[2]), (high[0], high[1], high[2])
