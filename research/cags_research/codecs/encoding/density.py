"""Encoding tiles of the density codec: which splats come first, and how a part stands for the whole."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cags_common.geometry import F32
from cags_common.splats import Ids
from cags_common.tiles.lod import LodLayer
from cags_research.codecs.cloud import encode_head
from cags_research.codecs.density import KIND, MAX_LOG_GAIN, DensityLevels, DensityTile, encode_density
from cags_research.codecs.encoding.scalar import ByteSplats, ScalarCodec

SHARES = (0.09, 0.125, 0.18, 0.25, 0.35, 0.5, 0.71, 1.0)
"""Share of a tile's splats that is there at each level: half an octave apart."""

AREA_POWER = 0.3
"""Weight of a splat's area against its opacity in its importance. Measured: with 1, large splats crowd out detail."""


class DensityCodec(ScalarCodec):
    """Tiles whose levels add splats, the most important first."""

    lod_order = tuple(LodLayer("density", level) for level in range(1, len(SHARES)))

    def opened(self, payload: bytes) -> DensityTile:
        """A tile, from its payload at LoD 0."""
        return DensityTile(payload, self.book)

    def encode_tile(self, ids: Ids, coded: ByteSplats, *, id_range: bool) -> tuple[bytes, ...]:
        """Encode a tile of splats [n] with ascending ``ids``."""
        grid = self.grid(coded)
        head = encode_head(KIND, ids, grid, id_range=id_range)
        cells = grid.quantise(coded.means)
        return tuple(encode_density(head, coded.columns, cells, grid.bits, levels_of(self._values(coded))))


def levels_of(values: Mapping[str, F32]) -> DensityLevels:
    """Nested subsets of splats with attributes ``values`` (attribute -> [n, dim]), and what makes up for the rest.

    A subset grows until it covers what all splats covered together (opacity times area), and in part until its count
    does: the first alone leaves holes in thin foliage, the second alone swells walls.
    """
    scales = np.sort(values["scale"].astype(np.float64), axis=1)
    opacity, area = values["alpha"][:, 0].astype(np.float64), np.exp(np.clip(scales[:, 1] + scales[:, 2], -60.0, 60.0))
    order = np.argsort(-opacity * area**AREA_POWER, kind="stable")
    ends = np.ceil(np.array(SHARES) * len(order)).astype(np.int64)
    mass = np.cumsum((opacity * area)[order])
    missing = np.log(mass[-1] / np.maximum(mass[ends - 1], 1e-30 * mass[-1]))
    gains = np.minimum(0.25 * missing + 0.125 * np.log(len(order) / ends), MAX_LOG_GAIN)
    return DensityLevels([np.sort(part) for part in np.split(order, ends[:-1])], gains.tolist())
