"""Scalable Vector Quantisation as a clip codec."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cags_common.coding.packing import U32
from cags_common.geometry import F32, F64
from cags_common.splats import Ids, Splats
from cags_common.tiles.attributes import join_attributes
from cags_common.tiles.contexts import I32, nearest
from cags_common.tiles.lod import MAX_POSITION_LAYERS, POSITION, LodLayer, position_layers
from cags_common.tiles.morton import morton_order, tile_ranges
from cags_common.tiles.payloads import (
    DELTA_TILE_SPLATS,
    KEY_TILE_SPLATS,
    MAX_POSITION_BITS,
    PositionGrid,
    encode_base,
    encode_looks_layer,
    encode_position_layer,
    near_of,
)
from cags_encoder.codecs.context_models import Tile, models_of
from cags_encoder.codecs.lod_order import order_of
from cags_encoder.quantiser.configs import COARSE_STEP, QuantiserConfig, quantiser_config
from cags_encoder.settings import EncodeSettings

if TYPE_CHECKING:
    from cags_encoder.quantiser.training import Quantiser

SPARSE = 8
"""Tiles of one splat in so many stand for what appears in later frames, further apart than in a key frame."""

SMALL_SPLATS = 0.25
"""Quantile of a tile's radii that determines its position step."""

MIN_POSITION_BITS = 4
"""Of LoD 0."""


def radii_of(splats: Splats) -> F32:
    """Standard deviations [n] along the middle axis, metres."""
    return np.asarray(np.exp(np.clip(np.median(splats.log_scales, axis=1), -30, 30)))


@dataclass(frozen=True, eq=False)
class SvqSplats:
    """Quantised splats."""

    means: F32  # [n, 3] unquantised
    radii: F32  # [n] standard deviation along the middle axis, metres
    codes: dict[str, U32]  # attribute -> [n] codes of full length
    refined: bool = False
    """Whether motion refines the positions, which then have :data:`COARSE_STEP`."""

    def take(self, rows: NDArray[Any] | slice) -> SvqSplats:
        """The splats at ``rows``."""
        codes = {name: codes[rows] for name, codes in self.codes.items()}
        return replace(self, means=self.means[rows], radii=self.radii[rows], codes=codes)

    def joined(self, other: SvqSplats) -> SvqSplats:
        """These splats, then the ``other`` ones."""
        codes = {name: np.concatenate([mine, other.codes[name]]) for name, mine in self.codes.items()}
        means, radii = np.concatenate([self.means, other.means]), np.concatenate([self.radii, other.radii])
        return replace(self, means=means, radii=radii, codes=codes)


@dataclass(frozen=True, eq=False)
class SvqCodec:
    """A :class:`~cags_encoder.codecs.registry.ClipCodec`."""

    quantiser: Quantiser
    lod_order: tuple[LodLayer, ...]
    lod_gains_db: tuple[float, ...]
    position_bits: int | None
    position_step: float
    """Of all levels, in radii of a tile's smaller splats."""
    coarse_step: float | None = None
    """The largest step of LoD 0, likewise, where an order may have layers of positions."""
    base_psnr_db: float | None = None

    @staticmethod
    def train(
        samples: Splats,
        settings: EncodeSettings,
        weights: F64 | None = None,
        config: QuantiserConfig | None = None,
    ) -> SvqCodec:
        """Train codebooks on ``samples`` [n] with ``weights`` [n], and choose the LoD order.

        ``config`` replaces the configuration named by the settings. Raises :class:`ConfigError`.
        """
        from cags_encoder.quantiser.training import train

        config = config or quantiser_config(settings.quantiser)
        quantiser = train(samples, config, settings.seed, weights)
        order = order_of(settings.lod_order, quantiser.books)
        step = config.position_step if settings.position_step is None else settings.position_step
        coarse = config.coarse_step if settings.position_bits is None else None
        return SvqCodec(quantiser, order, (), settings.position_bits, step, coarse)

    @property
    def finest_layers(self) -> int:
        """How many layers of positions lead from the largest step to that of all levels."""
        if self.coarse_step is None:
            return 0
        return min(max(round(math.log2(self.coarse_step / self.position_step)), 0), MAX_POSITION_LAYERS)

    @property
    def top_psnr_db(self) -> float | None:
        """PSNR of renders with every level; None if it was not measured."""
        return None if self.base_psnr_db is None else self.base_psnr_db + sum(self.lod_gains_db)

    def modelled(self, first: Splats) -> SvqCodec:
        """The codec with models of the codes of ``first`` [n], a key frame, where they pay."""
        coded = self.quantise(self.prepare(first)).take(morton_order(first.means))
        dense, sparse = self._tiles(coded, KEY_TILE_SPLATS), list[Tile]()
        if len(first) >= SPARSE * DELTA_TILE_SPLATS:
            sparse = self._tiles(coded.take(slice(None, None, SPARSE)), DELTA_TILE_SPLATS)
        return replace(self, quantiser=self.quantiser.modelled(models_of(self.quantiser.books, dense, sparse)))

    def _tiles(self, coded: SvqSplats, most: int) -> list[Tile]:
        cut = [coded.take(slice(*ends)) for ends in tile_ranges(len(coded.means), most)]
        return [(tile.codes, nearest(self.grid(tile).coarse(tile.means))) for tile in cut]

    def codebooks(self) -> bytes:
        """Serialised :class:`~cags_common.tiles.svq.CodebookSet`."""
        return self.quantiser.books.to_bytes()

    def prepare(self, splats: Splats) -> Splats:
        """Canonical axes, if the configuration uses them."""
        return self.quantiser.prepare(splats)

    def quantise(self, prepared: Splats) -> SvqSplats:
        """Codes of full length."""
        return SvqSplats(prepared.means, radii_of(prepared), self.quantiser.encode(prepared))

    def decode(self, coded: SvqSplats) -> Splats:
        """Look up all layers."""
        return join_attributes(coded.means, self.quantiser.decode(coded.codes))

    def shown(self, coded: SvqSplats) -> Splats:
        """Look up all layers of one tile and round its positions."""
        return self.decode(replace(coded, means=self.means_at(coded)))

    def means_at(self, coded: SvqSplats, layers: int | None = None) -> F32:
        """Positions [n, 3] of one tile in a decoder with so many layers of positions; None: with all."""
        grid = self.grid(coded)
        depth = grid.layers if layers is None else min(layers, grid.layers)
        return grid.dequantise(grid.quantise(coded.means) >> np.uint32(grid.layers - depth), depth)

    def encode_tile(self, ids: Ids, coded: SvqSplats, *, id_range: bool) -> tuple[bytes, ...]:
        """Coarse positions, by Draco, and base layers; then one packed layer per LoD."""
        grid = self.grid(coded)
        near = self._near(coded, grid)
        layers = (self._layer(coded, grid, near, item) for item in self.lod_order)
        return self._base(ids, coded, grid, id_range=id_range), *layers

    def base_bytes(self, coded: SvqSplats) -> int:
        """Size of LoD 0 of one tile of a key frame."""
        return len(self._base(np.arange(len(coded.means), dtype=np.int32), coded, self.grid(coded), id_range=True))

    def layer_bytes(self, coded: SvqSplats, item: LodLayer) -> int:
        """Size of one layer of one tile."""
        grid = self.grid(coded)
        return len(self._layer(coded, grid, self._near(coded, grid), item))

    def _base(self, ids: Ids, coded: SvqSplats, grid: PositionGrid, *, id_range: bool) -> bytes:
        books = self.quantiser.books
        base = {name: books[name].layer(codes, 0) for name, codes in coded.codes.items()}
        return encode_base(ids, coded.means, base, grid, books, id_range=id_range)

    def _near(self, coded: SvqSplats, grid: PositionGrid) -> I32 | None:
        return near_of(grid.coarse(coded.means), self.quantiser.books)

    def _layer(self, coded: SvqSplats, grid: PositionGrid, near: I32 | None, item: LodLayer) -> bytes:
        if item.attribute == POSITION:
            return encode_position_layer(coded.means, grid, item.layer)
        return encode_looks_layer(self.quantiser.books[item.attribute], item.layer, coded.codes[item.attribute], near)

    def grid(self, coded: SvqSplats) -> PositionGrid:
        """A tile's grid, fine enough for the smaller ones of its splats: an error shows against a splat's own size.

        It has as many layers as the order, but none where motion refines positions.
        """
        if self.position_bits is not None:
            return PositionGrid.over(coded.means, self.position_bits)
        radii = COARSE_STEP if coded.refined else self.position_step
        step = radii * float(np.quantile(coded.radii, SMALL_SPLATS)) if len(coded.radii) else 1.0
        extent = float(np.ptp(coded.means.astype(np.float64), axis=0).max(initial=0.0)) if len(coded.means) else 0.0
        bits = math.ceil(math.log2(extent / max(step, 1e-30) + 1))
        bits = min(max(bits, MIN_POSITION_BITS), MAX_POSITION_BITS)
        layers = 0 if coded.refined else min(position_layers(self.lod_order), bits - MIN_POSITION_BITS)
        return PositionGrid.over(coded.means, bits, layers)
