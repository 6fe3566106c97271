"""Tile payloads, both ways.

LoD 0 of a tile (``encode_base``) is a fixed header, the ids (absent in key frames, whose tiles are id ranges), and a
Draco point cloud in the tile's order: positions on a grid, and every attribute's base code as a generic attribute. Each
further LoD (``encode_layer``) is one enhancement layer's bits, packed and gzipped. CRCs travel beside payloads: one
flipped byte makes Draco decode wrong values without an error. Layout: ``docs/bundle.md``.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import DracoPy
import numpy as np

from cags_common.attributes import join_attributes
from cags_common.draco import decode_points
from cags_common.errors import DecodeError
from cags_common.geometry import F32
from cags_common.lod import LodLayer
from cags_common.packing import (
    U32,
    decode_ids,
    encode_ids,
    gunzip_bounded,
    gzip_bytes,
    pack_bits,
    packed_bytes,
    unpack_bits,
)
from cags_common.splats import MAX_SPLATS, Ids, Splats
from cags_common.svq import MAX_LAYER_BITS, CodebookSet

KEY_TILE_SPLATS = 8_000
DELTA_TILE_SPLATS = 4_000
"""Largest tiles of key frames and of the frames after them (paper, supplement, "Tiling")."""

MAX_TILE_SPLATS = 65_536
"""Bound on what a payload may claim."""

MAX_POSITION_BITS = 22
"""Grid coordinates travel through Draco as float32, which holds integers exactly up to 2**24."""

MAX_POSITION = 1e30
"""Bound on coordinates: sums and products of grids stay inside float32."""

DRACO_LEVEL = 7
BASE_VERSION = 1

_BASE_HEADER = struct.Struct("<BBBBII4f")
"""Version, flags, position bits, attributes, splats, first id or bytes of the id list, grid origin and step."""

_ID_RANGE = 1
"""Flag: the ids are a range (key frames), and only its first id is there."""


@dataclass(frozen=True, eq=False)
class PositionGrid:
    """The grid that a tile's positions are rounded to: ``origin + step * integer``."""

    origin: F32  # [3] world, metres
    step: float
    """Metres between neighbouring values, the same on all axes; a rounded position is off by at most half of it an
    axis.
    """
    bits: int

    @staticmethod
    def over(means: F32, bits: int) -> PositionGrid:
        """The finest grid of ``bits`` bits an axis over the cube that holds ``means`` [n, 3]."""
        low, extent = _low_and_extent(means)
        step = np.nextafter(np.float32(extent / (2**bits - 1)), np.float32(np.inf)) if extent > 0 else 0.0
        return PositionGrid(low, float(step), bits)

    def quantise(self, means: F32) -> U32:
        """Integer coordinates [n, 3] of ``means``."""
        if self.step == 0.0:
            return np.zeros(means.shape, np.uint32)
        cells = np.rint((means.astype(np.float64) - self.origin) / self.step)
        return np.clip(cells, 0, 2**self.bits - 1).astype(np.uint32)

    def dequantise(self, cells: Any) -> F32:
        """Means [n, 3] of integer coordinates."""
        wide: F32 = (self.origin.astype(np.float64) + cells.astype(np.float64) * self.step).astype(np.float32)
        return wide


@dataclass(frozen=True, eq=False)
class BaseTile:
    """What LoD 0 of a tile holds."""

    ids: Ids  # [n] ascending
    means: F32  # [n, 3] world, metres
    codes: dict[str, U32]  # attribute -> [n] base codes

    def __len__(self) -> int:
        return len(self.ids)


def encode_base(ids: Ids, means: F32, codes: Mapping[str, U32], grid: PositionGrid, *, id_range: bool) -> bytes:
    """LoD 0 of a tile: ``ids`` [n] ascending, ``means`` [n, 3], ``codes`` attribute -> [n] base codes < 256.

    ``codes`` is in coding order. With ``id_range`` (key frames) the ids are consecutive and only the first is written.
    The same input gives the same bytes.
    """
    id_bytes = b"" if id_range else encode_ids(ids)
    id_field = (int(ids[0]) if len(ids) else 0) if id_range else len(id_bytes)
    ox, oy, oz = (float(c) for c in grid.origin)
    header = _BASE_HEADER.pack(
        BASE_VERSION, _ID_RANGE * id_range, grid.bits, len(codes), len(ids), id_field, ox, oy, oz, grid.step
    )
    if len(ids) == 0:
        return header + id_bytes
    return header + id_bytes + _draco_encode(grid.quantise(means), codes, grid.bits)


def decode_base(payload: bytes | memoryview, codebooks: CodebookSet) -> BaseTile:
    """Inverse of :func:`encode_base`. Raises :class:`DecodeError` for damaged payloads."""
    head = _read_header(payload, len(codebooks))
    ids = _read_ids(payload, head)
    if head.splats == 0:
        return BaseTile(
            ids, np.zeros((0, 3), np.float32), {name: np.zeros(0, np.uint32) for name in codebooks.attributes}
        )
    cells, columns = _draco_decode(
        bytes(memoryview(payload)[_BASE_HEADER.size + head.id_bytes :]), head.splats, len(codebooks)
    )
    codes: dict[str, U32] = {}
    for book, column in zip(codebooks, columns, strict=True):
        if int(column.max()) >> book.layer_bits[0]:
            raise DecodeError(
                f"tile: base code {int(column.max())} of {book.attribute!r} exceeds {book.layer_bits[0]} bits"
            )
        codes[book.attribute] = column
    means = head.grid.dequantise(cells)
    if not np.isfinite(means).all():
        raise DecodeError("tile: a position is not finite")
    return BaseTile(ids, means, codes)


def decode_base_ids(payload: bytes | memoryview) -> Ids:
    """Only the ids [n] of a LoD 0 payload, without unpacking the rest."""
    return _read_ids(payload, _read_header(payload, None))


def encode_layer(codes: U32, bits: int) -> bytes:
    """One enhancement layer: ``codes`` [n] < 2**bits, packed and gzipped."""
    return gzip_bytes(pack_bits(codes, bits))


def decode_layer(payload: bytes | memoryview, count: int, bits: int) -> U32:
    """Inverse of :func:`encode_layer`: [count] uint32. Raises :class:`DecodeError`."""
    if not 1 <= bits <= MAX_LAYER_BITS or not 0 <= count <= MAX_TILE_SPLATS:
        raise DecodeError(f"layer: {count} codes of {bits} bits are outside the allowed range")
    return unpack_bits(gunzip_bounded(payload, packed_bytes(count, bits), "layer"), count, bits)


class TileState:
    """What a decoder holds of one tile: its base, and enhancement layers that may come in any order.

    An attribute is decoded to its *depth*: the number of layers there without a gap. Not thread-safe.
    """

    def __init__(self, base: BaseTile, codebooks: CodebookSet, lod_order: Sequence[LodLayer]) -> None:
        self.base = base
        self._books, self._order = codebooks, tuple(lod_order)
        self._codes = dict(base.codes)
        self._depth = dict.fromkeys(codebooks.attributes, 0)
        self._waiting: dict[tuple[str, int], U32] = {}

    def __len__(self) -> int:
        return len(self.base)

    @property
    def ids(self) -> Ids:
        """Ids [n], ascending."""
        return self.base.ids

    @property
    def means(self) -> F32:
        """Positions [n, 3], world, metres."""
        return self.base.means

    @property
    def lod(self) -> int:
        """Highest LoD up to which everything has come."""
        for level, item in enumerate(self._order):
            if self._depth[item.attribute] < item.layer:
                return level
        return len(self._order)

    def depth(self, attribute: str) -> int:
        """Enhancement layers of ``attribute`` that are decoded, from the base on without a gap."""
        return self._depth[attribute]

    def add_layer(self, lod: int, payload: bytes | memoryview) -> bool:
        """Take LoD ``lod`` >= 1.

        Returns whether a depth rose (a layer below may be missing still). Raises :class:`DecodeError`.
        """
        if not 1 <= lod <= len(self._order):
            raise DecodeError(f"tile: LoD {lod} is outside 1 to {len(self._order)}")
        item = self._order[lod - 1]
        if item.layer <= self._depth[item.attribute]:
            return False
        bits = self._books[item.attribute].layer_bits[item.layer]
        self._waiting[item.attribute, item.layer] = decode_layer(payload, len(self), bits)
        return self._absorb(item.attribute)

    def dequantise(self) -> Splats:
        """The tile's splats [n] at the depths there are, in the order of ``base.ids``."""
        values = {
            book.attribute: book.lookup(self._codes[book.attribute], self._depth[book.attribute] + 1)
            for book in self._books
        }
        return join_attributes(self.base.means, values)

    def _absorb(self, attribute: str) -> bool:
        before, book = self._depth[attribute], self._books[attribute]
        while (part := self._waiting.pop((attribute, self._depth[attribute] + 1), None)) is not None:
            self._depth[attribute] += 1
            bits = np.uint32(book.layer_bits[self._depth[attribute]])
            self._codes[attribute] = (self._codes[attribute] << bits) | part
        return self._depth[attribute] > before


@dataclass(frozen=True, slots=True)
class _Header:
    splats: int
    first_id: int | None
    id_bytes: int
    grid: PositionGrid


def _read_header(payload: bytes | memoryview, attributes: int | None) -> _Header:
    if len(payload) < _BASE_HEADER.size:
        raise DecodeError(f"tile: {len(payload)} bytes are too few for a base layer")
    version, flags, bits, columns, splats, id_field, ox, oy, oz, step = _BASE_HEADER.unpack_from(payload)
    if version != BASE_VERSION or flags & ~_ID_RANGE:
        raise DecodeError(f"tile: base layer of version {version}, flags {flags}; this program reads {BASE_VERSION}")
    first_id, id_bytes = (id_field, 0) if flags & _ID_RANGE else (None, id_field)
    if splats > MAX_TILE_SPLATS or bits > MAX_POSITION_BITS or id_bytes > len(payload) - _BASE_HEADER.size:
        raise DecodeError(f"tile: claims {splats} splats, {bits} position bits, {id_bytes} bytes of ids; beyond bounds")
    if first_id is not None and first_id > MAX_SPLATS - splats:
        raise DecodeError(f"tile: first id {first_id} is beyond {MAX_SPLATS} splats")
    if attributes is not None and columns != attributes:
        raise DecodeError(f"tile: has {columns} attributes, the codebooks {attributes}")
    reach = max(abs(ox), abs(oy), abs(oz)) + step * 2**bits
    if not all(map(math.isfinite, (ox, oy, oz, step))) or step < 0 or reach > MAX_POSITION:
        raise DecodeError(f"tile: its position grid is not finite or reaches beyond {MAX_POSITION:g}")
    return _Header(splats, first_id, id_bytes, PositionGrid(np.array([ox, oy, oz], np.float32), step, bits))


def _read_ids(payload: bytes | memoryview, head: _Header) -> Ids:
    if head.first_id is not None:
        return np.arange(head.first_id, head.first_id + head.splats, dtype=np.int32)
    ids = decode_ids(memoryview(payload)[_BASE_HEADER.size : _BASE_HEADER.size + head.id_bytes], what="tile ids")
    if len(ids) != head.splats:
        raise DecodeError(f"tile: has {len(ids)} ids for {head.splats} splats")
    return ids


def _draco_encode(cells: U32, codes: Mapping[str, U32], bits: int) -> bytes:
    # Draco rounds to a grid of its own: spanned over [0, 2**bits - 1] with that many bits, its grid is the integers.
    columns = {i: column.astype(np.uint8).reshape(-1, 1) for i, column in enumerate(codes.values())}
    encoded: bytes = DracoPy.encode(
        cells.astype(np.float32),
        quantization_bits=max(bits, 1),
        quantization_range=float(2 ** max(bits, 1) - 1),
        quantization_origin=np.zeros(3),
        compression_level=DRACO_LEVEL,
        preserve_order=True,
        generic_attributes=columns,
    )
    return encoded


def _draco_decode(data: bytes, count: int, attributes: int) -> tuple[F32, Iterable[U32]]:
    """Grid coordinates [count, 3] as float32, and the generic attributes in order."""
    cloud, columns = decode_points(data, count)
    shapes = [getattr(columns.get(i), "shape", None) for i in range(attributes)]
    # Damaged data may give a cloud without points, whose ``points`` is None.
    if getattr(cloud.points, "shape", None) != (count, 3) or shapes != [(count, 1)] * attributes:
        raise DecodeError("tile: Draco data lacks an attribute or holds one of another shape")
    return cloud.points, (columns[i][:, 0].astype(np.uint32) for i in range(attributes))


def _low_and_extent(means: F32) -> tuple[F32, float]:
    if len(means) == 0:
        return np.zeros(3, np.float32), 0.0
    low = means.min(axis=0)
    return low, float((means.max(axis=0).astype(np.float64) - low).max())
