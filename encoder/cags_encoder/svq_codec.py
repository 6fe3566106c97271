"""Scalable Vector Quantisation as a codec of clips."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from cags_common.attributes import join_attributes
from cags_common.geometry import F32
from cags_common.lod import LodLayer
from cags_common.packing import U32
from cags_common.splats import Ids, Splats
from cags_common.tiles import PositionGrid, encode_base, encode_layer
from cags_encoder.codecs import EncodedTile
from cags_encoder.lod_order import order_of
from cags_encoder.quantiser.configs import quantiser_config
from cags_encoder.quantiser.training import Quantiser, train
from cags_encoder.settings import EncodeSettings


@dataclass(frozen=True, eq=False)
class SvqSplats:
    """Quantised splats."""

    means: F32  # [n, 3] true
    codes: dict[str, U32]  # attribute -> [n] codes of full length

    def take(self, rows: NDArray[Any]) -> SvqSplats:
        """The splats at ``rows``."""
        return SvqSplats(self.means[rows], {name: codes[rows] for name, codes in self.codes.items()})


@dataclass(frozen=True, eq=False)
class SvqCodec:
    """A :class:`~cags_encoder.codecs.ClipCodec`."""

    quantiser: Quantiser
    lod_order: tuple[LodLayer, ...]
    lod_gains_db: tuple[float, ...]
    position_bits: int

    @staticmethod
    def train(samples: Splats, settings: EncodeSettings) -> SvqCodec:
        """Train codebooks on ``samples`` and choose the LoD order."""
        quantiser = train(samples, quantiser_config(settings.quantiser), settings.seed)
        return SvqCodec(quantiser, order_of(settings.lod_order, quantiser.books), (), settings.position_bits)

    def codebooks(self) -> bytes:
        """Serialised :class:`~cags_common.svq.CodebookSet`."""
        return self.quantiser.books.to_bytes()

    def prepare(self, splats: Splats) -> Splats:
        """Canonical axes, where the configuration has them."""
        return self.quantiser.prepare(splats)

    def quantise(self, prepared: Splats) -> SvqSplats:
        """Codes of full length."""
        return SvqSplats(prepared.means, self.quantiser.encode(prepared))

    def decode(self, coded: SvqSplats) -> Splats:
        """All layers looked up."""
        return join_attributes(coded.means, self.quantiser.decode(coded.codes))

    def encode_tile(self, ids: Ids, coded: SvqSplats, *, id_range: bool) -> EncodedTile:
        """Positions and base layers by Draco, then one packed layer a LoD."""
        books = self.quantiser.books
        grid = PositionGrid.over(coded.means, self.position_bits)
        base = {name: books[name].layer(codes, 0) for name, codes in coded.codes.items()}
        payloads = [encode_base(ids, coded.means, base, grid, id_range=id_range)]
        for item in self.lod_order:
            book = books[item.attribute]
            layer = book.layer(coded.codes[item.attribute], item.layer)
            payloads.append(encode_layer(layer, book.layer_bits[item.layer]))
        rounded = grid.dequantise(grid.quantise(coded.means))
        return EncodedTile(tuple(payloads), self.decode(SvqSplats(rounded, coded.codes)))
