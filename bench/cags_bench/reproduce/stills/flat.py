"""Flat quantisers of the paper's motivation: one k-means codebook an attribute, the codes in one Draco cloud.

Config 1 to 5: 8, 10, 12, 14, 16 bits of scale, 4, 7, 10, 13, 16 of rotation and of each band of harmonics, 4 of opacity
(caption of figure 'SRMotivation').
"""

from __future__ import annotations

from dataclasses import dataclass

import DracoPy
import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32
from cags_common.splats import Splats
from cags_common.tiles.attributes import join_attributes, split_attributes
from cags_common.tiles.morton import morton_order
from cags_encoder.quantiser.kmeans import NearestCentre

POSITION_BITS = 14
"""Bits of an axis of positions, which the paper does not say; the same for every configuration."""

LLOYD_STEPS = 8
"""Steps of k-means, where the encoder takes twenty: codebooks of 16,384 centres take seconds a step."""


@dataclass(frozen=True)
class FlatConfig:
    """Bits of the codes of each attribute."""

    scale: int
    others: int
    """Bits of rotation, and of each band of harmonics."""
    opacity: int = 4

    def bits(self, attribute: str) -> int:
        """Bits of ``attribute``'s codes."""
        return {"scale": self.scale, "alpha": self.opacity}.get(attribute, self.others)


CONFIGS = tuple(FlatConfig(scale, others) for scale, others in ((8, 4), (10, 7), (12, 10), (14, 13), (16, 16)))
"""The paper's configs 1 to 5."""


@dataclass(frozen=True)
class Flat:
    """A frame quantised flat."""

    splats: Splats
    """Decoded, in Morton order."""
    bytes: int
    """Draco's file: positions and codes."""
    codebook_bytes: int
    """Codebooks as float32, which a whole clip shares."""
    lossless: tuple[str, ...]
    """Attributes with no more distinct values than their codebook has entries."""


def quantised(splats: Splats, config: FlatConfig, seed: int = 0) -> Flat:
    """``splats`` quantised by ``config`` and decoded."""
    ordered = splats.take(morton_order(splats.means))
    values, codes, lossless, books = {}, {}, [], 0
    kept = ["scale", "rotation", "alpha", "sh0", *(f"sh{band}" for band in range(1, splats.sh_degree + 1))]
    parts = split_attributes(ordered)
    for index, name in enumerate(kept):
        points = np.ascontiguousarray(parts[name], np.float32)
        centres, distinct = _codebook(points, 2 ** config.bits(name), seed)
        code = NearestCentre(centres)(points)
        values[name], books = centres[code], books + centres.nbytes
        codes[index] = code.astype(np.uint8 if config.bits(name) <= 8 else np.uint16)[:, None]
        lossless += [name] if distinct else []
    data = DracoPy.encode(ordered.means, quantization_bits=POSITION_BITS, preserve_order=True, generic_attributes=codes)
    means = np.ascontiguousarray(DracoPy.decode(data).points, np.float32)
    return Flat(join_attributes(means, values), len(data), books, tuple(lossless))


def _codebook(points: F32, size: int, seed: int) -> tuple[F32, bool]:
    """At most ``size`` centres of ``points`` [n, dim], and whether they are all of the distinct points."""
    distinct = np.unique(points, axis=0)
    if len(distinct) <= size:
        return distinct, True
    rng = np.random.default_rng(seed)
    centres = distinct[rng.choice(len(distinct), size, replace=False)]
    for _ in range(LLOYD_STEPS):
        centres = _step(points, centres, NearestCentre(centres)(points))
    return centres, False


def _step(points: F32, centres: F32, nearest: NDArray[np.int64]) -> F32:
    """Means of the points nearest to each centre; a centre without points stays."""
    counts = np.bincount(nearest, minlength=len(centres))
    sums = np.stack([np.bincount(nearest, column, len(centres)) for column in points.T.astype(np.float64)], axis=1)
    held = counts > 0
    moved = centres.copy()
    moved[held] = (sums[held] / counts[held, None]).astype(np.float32)
    return moved
