"""This project's codebooks: a tree by splitting, and a second, shared tree that refines its leaves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cags_common.coding.packing import U32
from cags_common.geometry import F32, F64
from cags_common.tiles.svq import Codebook
from cags_encoder.quantiser.configs import AttributeQuantiser, QuantiserConfig
from cags_encoder.quantiser.kmeans import NearestCentre
from cags_encoder.quantiser.printed import layers_of
from cags_encoder.quantiser.splitting import cell_spreads, halving_tree, split_tree

REFINE_LIMIT = 4.0
"""Offsets are limited to this many spreads before the second tree is trained, so that outliers do not dominate it."""


class LayeredEncoder:
    """Trains and assigns one attribute's codes.

    Tables are rounded to float16 and codes are found with the rounded tables, which the decoder uses.
    """

    def __init__(self, values: F32, weights: F64, attribute: AttributeQuantiser, config: QuantiserConfig) -> None:
        self._attribute = attribute
        points = attribute.to_space(values).astype(np.float64)
        means, cells = _tree(points, weights, attribute.tree_bits, config.base_bits)
        depth = len(means) - 1
        layers = layers_of(depth, config)
        tables = [_half(means[bits]) for bits in np.cumsum(layers)]
        more = attribute.refine_bits if not np.allclose(points, means[-1][cells], rtol=1e-6, atol=1e-9) else 0
        spreads = None
        refine: tuple[int, ...] = ()
        if more:
            spreads = np.maximum(_half(cell_spreads(points, weights, cells, tables[-1].astype(np.float64))), _TINY)
            offsets = np.clip((points - tables[-1][cells]) / spreads[cells], -REFINE_LIMIT, REFINE_LIMIT)
            finer, _ = split_tree(offsets, weights * np.square(spreads[cells]).mean(axis=1), more)
            refine = _chunks(more, config.layer_bits)
            tables += [_half(finer[bits]) for bits in np.cumsum(refine)]
        self.book = Codebook(attribute.attribute, layers + refine, tuple(tables), len(layers), spreads)
        self._leaves = NearestCentre(tables[len(layers) - 1])
        self._offsets = NearestCentre(tables[-1]) if more else None

    def encode(self, values: F32) -> U32:
        """Codes [n] of full length of raw values [n, dim]: the nearest leaf, then the nearest offset from it."""
        points = self._attribute.to_space(values)
        leaves = self._leaves(points)
        if self._offsets is None or self.book.spreads is None:
            return leaves.astype(np.uint32)
        tree = self.book.first_stage
        offsets = (points - self.book.tables[tree - 1][leaves]) / self.book.spreads[leaves]
        below = self.book.code_bits(len(self.book.layer_bits)) - self.book.code_bits(tree)
        return ((leaves << below) | self._offsets(offsets)).astype(np.uint32)


_TINY = np.float32(2.0**-14)
"""Smallest spread: the smallest normal float16."""


def _half(values: F64) -> F32:
    """Rounded to float16, within its range."""
    return np.clip(values, -6e4, 6e4).astype(np.float16).astype(np.float32)


def _tree(points: F64, weights: F64, bits: int, base_bits: int) -> tuple[list[F64], NDArray[np.int64]]:
    """Cell means by level and the points' cells. If there are few distinct points, each gets its own cell."""
    distinct, which = np.unique(points, axis=0, return_inverse=True)
    if len(distinct) > 1 << bits:
        return split_tree(points, weights, bits)
    depth = max(base_bits, (len(distinct) - 1).bit_length())
    means, cells = halving_tree(distinct, np.bincount(which, weights).astype(np.float64), depth)
    return means, cells[which]


def _chunks(bits: int, largest: int) -> tuple[int, ...]:
    full, rest = divmod(bits, largest)
    return (*(largest,) * full, *((rest,) if rest else ()))
