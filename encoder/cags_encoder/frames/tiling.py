"""Cutting a frame into tiles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cags_common.bundle import TilePayloads
from cags_common.geometry import F32, Vec3
from cags_common.morton import morton_order, tile_ranges
from cags_common.splats import Ids, Splats
from cags_encoder.codecs import ClipCodec, CodedSplats


@dataclass(frozen=True, eq=False)
class TiledFrame:
    """The tiles of one frame, and what a decoder that has every LoD makes of them."""

    tiles: tuple[TilePayloads, ...]
    ids: Ids  # [n] as tiled
    decoded: Splats | None  # [n]; None for a frame without splats


def encode_tiles(
    codec: ClipCodec, ids: Ids, means: F32, coded: CodedSplats, *, largest: int, id_range: bool
) -> TiledFrame:
    """Encode splats ``ids`` [n] at ``means`` [n, 3] in tiles of at most ``largest``.

    With ``id_range`` they are in Morton order already and their ids count up from 0; otherwise they are put in Morton
    order, cut, and sorted by id within each tile.
    """
    order = np.arange(len(ids)) if id_range else morton_order(means)
    tiles, tiled, decoded = [], [], []
    for first, end in tile_ranges(len(ids), largest):
        run = order[first:end]
        rows = run[np.argsort(ids[run], kind="stable")]
        tile = codec.encode_tile(ids[rows], coded.take(rows), id_range=id_range)
        first_id = int(ids[rows[0]]) if id_range else None
        tiles.append(TilePayloads(len(rows), first_id, corners(means[rows]), tile.payloads))
        tiled.append(ids[rows])
        decoded.append(tile.decoded)
    if not tiles:
        return TiledFrame((), ids, None)
    return TiledFrame(tuple(tiles), np.concatenate(tiled), Splats.concatenate(decoded))


def corners(means: F32) -> tuple[Vec3, Vec3]:
    """Smallest and largest corner of points [n, 3], n >= 1."""
    low, high = means.min(axis=0).tolist(), means.max(axis=0).tolist()
    return (low[0], low[1], low[2]), (high[0], high[1], high[2])
