"""Cuts frames into tiles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cags_common.geometry import F32, Vec3, axis_bounds
from cags_common.splats import Ids
from cags_common.tiles.morton import morton_order, tile_ranges
from cags_encoder.codecs.registry import CodedSplats


@dataclass(frozen=True, eq=False)
class CutTile:
    """One tile, before packing."""

    ids: Ids  # [n] ascending
    id_range: bool
    """Whether ids are consecutive (key frames)."""
    bounds: tuple[Vec3, Vec3]
    coded: CodedSplats  # [n]


def cut_tiles(ids: Ids, means: F32, coded: CodedSplats, *, largest: int, id_range: bool) -> tuple[CutTile, ...]:
    """Cut splats ``ids`` [n] at ``means`` [n, 3] into tiles of at most ``largest``.

    If ``id_range``, splats are in Morton order already and their ids count up from 0. Otherwise they are put in Morton
    order, cut, and sorted by id within each tile.
    """
    order = np.arange(len(ids)) if id_range else morton_order(means)
    tiles = []
    for first, end in tile_ranges(len(ids), largest):
        run = order[first:end]
        rows = run[np.argsort(ids[run], kind="stable")]
        tiles.append(CutTile(ids[rows], id_range, corners(means[rows]), coded.take(rows)))
    return tuple(tiles)


def corners(means: F32) -> tuple[Vec3, Vec3]:
    """Smallest and largest corner of points [n, 3], n >= 1."""
    low, high = (corner.tolist() for corner in axis_bounds(means))
    return (low[0], low[1], low[2]), (high[0], high[1], high[2])
