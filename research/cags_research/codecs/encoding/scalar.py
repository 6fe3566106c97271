"""What the baselines' encoders share: every number of an attribute is a byte."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle.codecs import TileDecoder
from cags_common.geometry import F32, F64
from cags_common.splats import Ids, Splats
from cags_common.tiles.attributes import join_attributes, split_attributes
from cags_common.tiles.lod import LodLayer
from cags_common.tiles.payloads import PositionGrid
from cags_encoder.settings import EncodeSettings
from cags_research.codecs.scalar import U8, ScalarBook

POSITION_BITS = 16
"""Bits an axis over each tile's cube, as V3 has them, unless the settings say otherwise."""


@dataclass(frozen=True, eq=False)
class ByteSplats:
    """Quantised splats [n]."""

    means: F32  # [n, 3] true
    columns: tuple[U8, ...]  # attribute by attribute [n, dim], in the book's order

    def take(self, rows: NDArray[Any]) -> ByteSplats:
        """The splats at ``rows``."""
        return ByteSplats(self.means[rows], tuple(column[rows] for column in self.columns))


class ScalarCodec(ABC):
    """Bytes between the extreme values of ``samples``: a :class:`~cags_encoder.codecs.registry.ClipCodec`."""

    lod_order: tuple[LodLayer, ...]
    lod_gains_db: tuple[float, ...] = ()
    base_psnr_db: float | None = None

    def __init__(self, samples: Splats, settings: EncodeSettings, _weights: F64 | None = None) -> None:
        self.book = ScalarBook.over(split_attributes(samples))
        self._position_bits = settings.position_bits or POSITION_BITS

    def codebooks(self) -> bytes:
        """The ranges."""
        return self.book.to_bytes()

    def prepare(self, splats: Splats) -> Splats:
        """The splats as they are: a decoder gives back the same form."""
        return splats

    def quantise(self, prepared: Splats) -> ByteSplats:
        """Splats [n] as bytes."""
        values = split_attributes(prepared)
        return ByteSplats(prepared.means, tuple(self.book.quantise(name, values[name]) for name in self.book))

    def decode(self, coded: ByteSplats) -> Splats:
        """What is left after quantisation [n]."""
        return join_attributes(coded.means, self._values(coded))

    def shown(self, coded: ByteSplats) -> Splats:
        """One tile, its positions rounded."""
        grid = self.grid(coded)
        return join_attributes(grid.dequantise(grid.quantise(coded.means)), self._values(coded))

    @abstractmethod
    def encode_tile(self, ids: Ids, coded: ByteSplats, *, id_range: bool) -> tuple[bytes, ...]:
        """Encode a tile of splats [n] with ascending ``ids``."""

    @abstractmethod
    def opened(self, payload: bytes) -> TileDecoder:
        """A tile of this codec, from its payload at LoD 0."""

    def levels(self, coded: ByteSplats) -> Iterator[Splats]:
        """What a decoder shows of one tile at each LoD, from 0 on."""
        first, *more = self.encode_tile(np.arange(len(coded.means), dtype=np.int32), coded, id_range=True)
        tile = self.opened(first)
        yield tile.dequantise()
        for lod, payload in enumerate(more, start=1):
            tile.add_layer(lod, payload)
            yield tile.dequantise()

    def with_measured(self, psnr_db: tuple[float, ...]) -> Self:
        """The same codec, which knows the PSNR of each LoD from 0 on, or of none."""
        known = copy(self)
        known.base_psnr_db = psnr_db[0] if psnr_db else None
        known.lod_gains_db = tuple(round(after - before, 4) for before, after in pairwise(psnr_db))
        return known

    def grid(self, coded: ByteSplats) -> PositionGrid:
        """A tile's grid of positions."""
        return PositionGrid.over(coded.means, self._position_bits)

    def _values(self, coded: ByteSplats) -> dict[str, F32]:
        return {name: self.book.dequantise(name, column) for name, column in zip(self.book, coded.columns, strict=True)}
