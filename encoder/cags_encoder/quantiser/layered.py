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
from cags_encoder.quantiser.rounding import on_steps, rounded_spreads
from cags_encoder.quantiser.splitting import cell_spreads, halving_tree, split_tree

REFINE_LIMIT = 4.0
"""Offsets are limited to this many spreads before the second tree is trained, so that outliers do not dominate it."""


class LayeredEncoder:
    """Trains and assigns one attribute's codes.

    Codes are found with the rounded tables, which the decoder uses.
    """

    def __init__(self, values: F32, weights: F64, attribute: AttributeQuantiser, config: QuantiserConfig) -> None:
        self._attribute = attribute
        points = attribute.to_space(values).astype(np.float64)
        means, cells = _tree(points, weights, attribute.tree_bits, config.base_bits)
        layers = layers_of(len(means) - 1, config)
        tables = _tables(points, weights, means, cells, layers)
        more = attribute.refine_bits if not np.allclose(points, means[-1][cells], rtol=1e-6, atol=1e-9) else 0
        spreads = None
        refine: tuple[int, ...] = ()
        if more:
            leaves = tables[-1].astype(np.float64)
            spreads = rounded_spreads(cell_spreads(points, weights, cells, leaves))
            offsets = np.clip((points - leaves[cells]) / spreads[cells], -REFINE_LIMIT, REFINE_LIMIT)
            shares = weights * np.square(spreads[cells]).mean(axis=1)
            finer, below = split_tree(offsets, shares, more)
            refine = _chunks(more, config.layer_bits)
            tables += _tables(offsets, shares, finer, below, refine)
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


def _tables(
    points: F64, weights: F64, means: list[F64], cells: NDArray[np.int64], layers: tuple[int, ...]
) -> list[F32]:
    """Rows of codes that end after each layer; ``means`` are those of every level, ``cells`` the last one's."""
    depths = np.cumsum(layers)
    left = [_deviations(points, weights, means[depth][cells >> (depths[-1] - depth)]) for depth in depths]
    return on_steps([means[depth] for depth in depths], left)


def _deviations(points: F64, weights: F64, centres: F64) -> F64:
    """Weighted root mean square [dim] of what ``centres`` [n, dim] leave of ``points`` [n, dim]."""
    left: F64 = np.sqrt(np.average(np.square(points - centres), axis=0, weights=weights))
    return left


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
