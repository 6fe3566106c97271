"""Codebooks as in the paper: k-means, then merging bottom-up into binary trees."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cags_common.coding.packing import U32
from cags_common.geometry import F32, F64
from cags_common.tiles.svq import Codebook
from cags_encoder.quantiser.configs import AttributeQuantiser, QuantiserConfig
from cags_encoder.quantiser.kmeans import NearestCentre, kmeans
from cags_encoder.quantiser.merging import merge_as_printed
from cags_encoder.quantiser.rounding import on_steps
from cags_encoder.quantiser.tree import Node, assign_codes, code_length

MERGE_SAMPLES = 16_384
"""Number of members for merge distances, whose time is proportional to it."""

SLACK_BITS = 2
"""Codes may be this many bits longer than the logarithm of the number of leaves; deeper trees are cut in the middle."""


class PrintedEncoder:
    """Trains and assigns one attribute's codes."""

    def __init__(self, values: F32, attribute: AttributeQuantiser, config: QuantiserConfig, seed: int) -> None:
        self._attribute = attribute
        points = np.ascontiguousarray(attribute.to_space(values), dtype=np.float32)
        centres = kmeans(points, 1 << attribute.tree_bits, seed)
        labels = NearestCentre(centres)(points)
        used, labels = np.unique(labels, return_inverse=True)
        weights = np.bincount(labels).astype(np.float64)
        sums = [np.bincount(labels, column, len(used)) for column in points.T.astype(np.float64)]
        means: F64 = np.stack(sums, axis=1).astype(np.float64) / weights[:, None]
        roots = _roots(points, labels, centres[used], config)
        layers = layers_of(code_length(roots, config.base_bits, attribute.tree_bits + SLACK_BITS), config)
        coded = assign_codes(roots, means, weights, layers)
        tables = [attribute.from_space(table).astype(np.float64) for table in coded.tables]
        raw, codes, depths = attribute.from_space(points), coded.codes[labels], np.cumsum(layers)
        left = [(raw - table[codes >> (depths[-1] - d)]).std(axis=0) for table, d in zip(tables, depths, strict=True)]
        self.book = Codebook(attribute.attribute, layers, tuple(on_steps(tables, left)))
        self._nearest, self._codes = NearestCentre(means.astype(np.float32)), coded.codes

    def encode(self, values: F32) -> U32:
        """Codes [n] of full length for raw values [n, dim]: the nearest leaf in the space of the clustering."""
        codes: U32 = self._codes[self._nearest(self._attribute.to_space(values))]
        return codes


def layers_of(length: int, config: QuantiserConfig) -> tuple[int, ...]:
    """The base layer and as many enhancement layers as ``length`` bits need."""
    full, rest = divmod(max(length - config.base_bits, 0), config.layer_bits)
    return (config.base_bits, *(config.layer_bits,) * full, *((rest,) if rest else ()))


def _roots(points: F32, labels: NDArray[np.int64], centres: F32, config: QuantiserConfig) -> list[Node]:
    """Trees of the base clusters, sorted along the axis in which they differ most, so that close codes are close
    values.
    """
    step = max(1, len(points) // MERGE_SAMPLES)
    rows = np.unique(np.concatenate([np.arange(0, len(points), step), np.unique(labels, return_index=True)[1]]))
    roots = merge_as_printed(points[rows], labels[rows], centres, min(1 << config.base_bits, len(centres)))
    middles = np.array([centres[root.leaves()].mean(axis=0) for root in roots])
    widest = int(np.argmax(middles.max(axis=0) - middles.min(axis=0)))
    return [roots[i] for i in np.argsort(middles[:, widest], kind="stable")]
