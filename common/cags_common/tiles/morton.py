"""Morton (Z-order) sorting of points, and cutting a sorted run into tiles of equal counts."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32, axis_bounds

AXIS_BITS = 21
"""Bits an axis in a 63-bit Morton code."""

_SPREAD_STEPS = (
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def morton_codes(means: F32) -> NDArray[np.uint64]:
    """63-bit Morton codes [n] of points [n, 3], over the cube that holds them. Zero-extent bounds give code 0."""
    if len(means) == 0:
        return np.zeros(0, np.uint64)
    wide = means.astype(np.float64)
    low, high = (corner.astype(np.float64) for corner in axis_bounds(means))
    extent = float((high - low).max())
    scale = (2**AXIS_BITS - 1) / extent if extent > 0 else 0.0
    cells = np.minimum((wide - low) * scale, 2**AXIS_BITS - 1).astype(np.uint64)
    codes: NDArray[np.uint64] = (
        _spread(cells[:, 0]) | (_spread(cells[:, 1]) << np.uint64(1)) | (_spread(cells[:, 2]) << np.uint64(2))
    )
    return codes


def morton_order(means: F32) -> NDArray[np.int64]:
    """Rows [n] in Morton order; equal codes keep their order, so that the result is deterministic."""
    return np.argsort(morton_codes(means), kind="stable")


def tile_ranges(count: int, largest: int) -> list[tuple[int, int]]:
    """Cut ``count`` splats into the fewest runs of at most ``largest``, whose lengths differ by one at most.

    Returns ``(first, end)`` of each run; none for no splats.
    """
    tiles = -(-count // largest)
    edges = [count * i // tiles for i in range(tiles + 1)] if tiles else [0]
    return list(pairwise(edges))


def _spread(cells: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Put two zero bits between the bits of 21-bit numbers."""
    for shift, mask in _SPREAD_STEPS:
        cells = (cells | (cells << np.uint64(shift))) & np.uint64(mask)
    return cells
