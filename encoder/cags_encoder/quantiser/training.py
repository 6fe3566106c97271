"""From samples of splats to codebooks, and from splats to codes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cags_common.attributes import split_attributes
from cags_common.geometry import F32, F64
from cags_common.packing import U32
from cags_common.splats import Splats
from cags_common.svq import Codebook, CodebookSet
from cags_encoder.quantiser.configs import AttributeQuantiser, QuantiserConfig
from cags_encoder.quantiser.kmeans import NearestCentre, kmeans
from cags_encoder.quantiser.merging import merge_as_printed
from cags_encoder.quantiser.tree import Node, assign_codes, code_length

MERGE_SAMPLES = 16_384
"""Members that merge distances are taken over: the paper's distance costs time in proportion."""

SLACK_BITS = 2
"""Bits a code may be longer than the logarithm of its leaves; a deeper tree is cut in the middle there."""


@dataclass(frozen=True, eq=False)
class AttributeEncoder:
    """Assigns one attribute's codes."""

    config: AttributeQuantiser
    book: Codebook
    nearest: NearestCentre
    leaf_codes: U32  # [leaves] codes of full length

    def encode(self, values: F32) -> U32:
        """Codes [n] of full length of raw values [n, dim]: the nearest leaf in the space that was clustered."""
        return self.leaf_codes[self.nearest(self.config.to_space(values))]


class Quantiser:
    """The codebooks of a clip and the way to encode with them."""

    def __init__(self, encoders: list[AttributeEncoder]) -> None:
        self._encoders = encoders
        self.books = CodebookSet({encoder.book.attribute: encoder.book for encoder in encoders})

    def encode(self, splats: Splats) -> dict[str, U32]:
        """Attribute -> codes [n] of full length."""
        values = split_attributes(splats)
        return {e.book.attribute: e.encode(values[e.book.attribute]) for e in self._encoders}

    def decode(self, codes: dict[str, U32]) -> dict[str, F32]:
        """Attribute -> values [n, dim], as a decoder that has every layer sees them."""
        return {book.attribute: book.lookup(codes[book.attribute], len(book.layer_bits)) for book in self.books}


def train(samples: Splats, config: QuantiserConfig, seed: int) -> Quantiser:
    """Train every attribute's codebook on ``samples`` (n >= 1). Deterministic for a seed."""
    values = split_attributes(samples)
    return Quantiser(
        [_train_attribute(values[a.attribute], a, config, seed) for a in config.attributes if a.attribute in values]
    )


def _train_attribute(
    values: F32, attribute: AttributeQuantiser, config: QuantiserConfig, seed: int
) -> AttributeEncoder:
    points = np.ascontiguousarray(attribute.to_space(values), dtype=np.float32)
    centres = kmeans(points, 1 << attribute.leaf_bits, seed)
    labels = NearestCentre(centres)(points)
    used, labels = np.unique(labels, return_inverse=True)
    centres = centres[used]
    weights = np.bincount(labels).astype(np.float64)
    sums = [np.bincount(labels, column, len(used)) for column in points.T.astype(np.float64)]
    means: F64 = np.stack(sums, axis=1).astype(np.float64) / weights[:, None]
    roots = _roots(points, labels, centres, config)
    length = code_length(roots, config.base_bits, attribute.leaf_bits + SLACK_BITS)
    layers = _layers(length, config)
    coded = assign_codes(roots, means, weights, layers)
    tables = tuple(attribute.from_space(table) for table in coded.tables)
    book = Codebook(attribute.attribute, layers, tables)
    return AttributeEncoder(attribute, book, NearestCentre(means.astype(np.float32)), coded.codes)


def _roots(points: F32, labels: np.ndarray, centres: F32, config: QuantiserConfig) -> list[Node]:
    """Trees of the base clusters, along the axis in which they differ most: close codes are close values."""
    step = max(1, len(points) // MERGE_SAMPLES)
    rows = np.unique(np.concatenate([np.arange(0, len(points), step), np.unique(labels, return_index=True)[1]]))
    roots = merge_as_printed(points[rows], labels[rows], centres, min(1 << config.base_bits, len(centres)))
    middles = np.array([centres[root.leaves()].mean(axis=0) for root in roots])
    widest = int(np.argmax(middles.max(axis=0) - middles.min(axis=0)))
    return [roots[i] for i in np.argsort(middles[:, widest], kind="stable")]


def _layers(length: int, config: QuantiserConfig) -> tuple[int, ...]:
    """The base layer and as many enhancement layers as ``length`` bits take."""
    above = max(length - config.base_bits, 0)
    full, rest = divmod(above, config.layer_bits)
    return (config.base_bits, *(config.layer_bits,) * full, *((rest,) if rest else ()))
