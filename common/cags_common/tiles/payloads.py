"""Tile payloads, both ways.

LoD 0 of a tile (``encode_base``) is a fixed header, the ids (absent in key frames, whose tiles are id ranges), a Draco
point cloud of the highest bits of the positions on a grid, in the tile's order, and every attribute's base codes. Each
further LoD is one enhancement layer's bits (``encode_looks_layer``), or the next bit of positions
(``encode_position_layer``). Codes of layers that have a model are coded by context (:mod:`.contexts`); others are
packed, and deflated where that is shorter. CRCs travel beside payloads: one
flipped byte makes Draco decode wrong values without an error. Layout: ``docs/bundle.md``.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import DracoPy
import numpy as np
from numpy.typing import NDArray

from cags_common.coding.draco import decode_points
from cags_common.coding.packing import (
    U32,
    PackedCodes,
    decode_ids,
    encode_ids,
    pack_bits,
    packed_bytes,
    squeeze,
    unsqueeze,
)
from cags_common.errors import DecodeError
from cags_common.geometry import F32, axis_bounds
from cags_common.splats import MAX_SPLATS, Ids
from cags_common.tiles import dequantise
from cags_common.tiles.contexts import I32, decode_codes, encode_codes, nearest
from cags_common.tiles.lod import MAX_POSITION_LAYERS
from cags_common.tiles.svq import MAX_LAYER_BITS, Codebook, CodebookSet

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
BASE_VERSION = 10
"""Version 1 carried base codes as generic attributes inside Draco, which took as long to decode as the positions;
version 2 had no layers of positions, version 9 no codes by context.
"""

_BASE_HEADER = struct.Struct("<BBBBIII4f")
"""Version, flags and layers of positions, position bits, attributes, splats, first id or bytes of the id list, bytes of
the Draco data, grid origin and step.
"""

_ID_RANGE = 1
"""Flag: the ids are a range (key frames), and only its first id is there."""

_LAYERS_SHIFT = 4
"""The four high bits of the flags are the number of layers of positions."""


@dataclass(frozen=True, eq=False)
class PositionGrid:
    """The grid that a tile's positions are rounded to: ``origin + step * integer``.

    The integers' lowest bits are ``layers`` of their own. Until those come, a position is the middle of all that it may
    become.
    """

    origin: F32  # [3] world, metres
    step: float
    """Metres between neighbouring values, the same on all axes; a rounded position is off by at most half of it an
    axis.
    """
    bits: int
    """Of an integer, with those of the layers."""
    layers: int = 0
    """Bits that are layers of their own."""

    @staticmethod
    def over(means: F32, bits: int, layers: int = 0) -> PositionGrid:
        """The finest grid of ``bits`` bits an axis over the cube that holds ``means`` [n, 3]."""
        low, extent = _low_and_extent(means)
        step = np.nextafter(np.float32(extent / (2**bits - 1)), np.float32(np.inf)) if extent > 0 else 0.0
        return PositionGrid(low, float(step), bits, layers)

    def quantise(self, means: F32) -> U32:
        """Integer coordinates [n, 3] of ``means``."""
        if self.step == 0.0:
            return np.zeros(means.shape, np.uint32)
        cells = np.rint((means.astype(np.float64) - self.origin) / self.step)
        return np.clip(cells, 0, 2**self.bits - 1).astype(np.uint32)

    def coarse(self, means: F32) -> F32:
        """Integer coordinates [n, 3] of ``means`` without the bits of the layers, as LoD 0 tells them."""
        return (self.quantise(means) >> np.uint32(self.layers)).astype(np.float32)

    def dequantise(self, cells: Any, layers: int | None = None) -> F32:
        """Means [n, 3] of integer coordinates that have the bits of the first ``layers`` only; None: of all."""
        lacking = 0 if layers is None else self.layers - layers
        middle = 0.5 * (2**lacking - 1)
        # Whole and half numbers below 2**23: exact in single precision, too.
        whole = cells if not lacking else cells.astype(np.float32) * np.float32(2**lacking) + np.float32(middle)
        return dequantise.positions(whole, self.origin, self.step)


@dataclass(frozen=True, eq=False)
class BaseTile:
    """What LoD 0 of a tile holds."""

    ids: Ids  # [n] ascending
    grid: PositionGrid
    cells: F32  # [n, 3] integer coordinates, without the bits of the layers of positions
    layers: dict[str, PackedCodes]  # attribute -> n base codes

    def __len__(self) -> int:
        return len(self.ids)

    @cached_property
    def means(self) -> F32:
        """Positions [n, 3] as LoD 0 tells them, world, metres."""
        return self.grid.dequantise(self.cells, 0)

    @cached_property
    def near(self) -> I32:
        """The near ones [n, 2] of each splat, by which codes are coded."""
        return nearest(self.cells)

    def refined(self, bits: Sequence[NDArray[np.uint8]]) -> F32:
        """Positions [n, 3] with the first layers' ``bits`` [n, 3], world, metres."""
        low = np.zeros(self.cells.shape, np.uint8)
        for layer in bits:
            low += low
            low += layer
        cells = self.cells * np.float32(2 ** len(bits))
        cells += low
        return self.grid.dequantise(cells, len(bits))

    @property
    def codes(self) -> dict[str, U32]:
        """Attribute -> base codes [n]."""
        return {name: layer.unpack(len(self)) for name, layer in self.layers.items()}


def encode_base(
    ids: Ids, means: F32, codes: Mapping[str, U32], grid: PositionGrid, codebooks: CodebookSet, *, id_range: bool
) -> bytes:
    """LoD 0 of a tile: ``ids`` [n] ascending, ``means`` [n, 3], ``codes`` attribute -> [n] base codes. Layers of
    positions, of which ``grid`` says how many there are, are payloads of their own.

    With ``id_range`` (key frames) the ids are consecutive and only the first is written. The same input gives the same
    bytes.
    """
    id_bytes = b"" if id_range else encode_ids(ids)
    id_field = (int(ids[0]) if len(ids) else 0) if id_range else len(id_bytes)
    ox, oy, oz = (float(c) for c in grid.origin)
    cells = grid.coarse(means)
    draco = _draco_encode(cells, grid.bits - grid.layers) if len(ids) else b""
    flags = _ID_RANGE * id_range | grid.layers << _LAYERS_SHIFT
    header = _BASE_HEADER.pack(
        *(BASE_VERSION, flags, grid.bits, len(codebooks), len(ids), id_field, len(draco)),
        *(ox, oy, oz, grid.step),
    )
    return header + id_bytes + draco + _encoded_base(codes, codebooks, near_of(cells, codebooks))


def near_of(cells: F32, codebooks: CodebookSet) -> I32 | None:
    """Near ones [n, 2] of splats at the ``cells`` [n, 3] of LoD 0; None where no codes are coded by context."""
    return nearest(cells) if any(any(book.models) for book in codebooks) else None


def _encoded_base(codes: Mapping[str, U32], codebooks: CodebookSet, near: I32 | None) -> bytes:
    """The bytes of what is coded by context, u32 each, and these parts; then all that is packed."""
    parts = [
        encode_codes(model, codes[book.attribute], None, near)
        for book in codebooks
        if (model := book.model(0)) is not None and near is not None
    ]
    packed = [pack_bits(codes[b.attribute], b.layer_bits[0]) for b in codebooks if b.model(0) is None]
    return b"".join([struct.pack(f"<{len(parts)}I", *map(len, parts)), *parts, squeeze(b"".join(packed))])


def decode_base(payload: bytes | memoryview, codebooks: CodebookSet) -> BaseTile:
    """Inverse of :func:`encode_base`. Raises :class:`DecodeError` for damaged payloads."""
    head = _read_header(payload, len(codebooks))
    ids, (draco, codes) = _read_ids(payload, head), head.sections(payload)
    cells = np.zeros((0, 3), np.float32)
    if head.splats:
        cells = _draco_decode(bytes(draco), head.splats, head.grid)
    tile = BaseTile(ids, head.grid, cells, {})
    tile.layers.update(_base_layers(codes, tile, codebooks))
    return tile


def position_bytes(payload: bytes | memoryview) -> int:
    """How many bytes of a LoD 0 payload are not base codes. Raises :class:`DecodeError`."""
    return len(payload) - len(_read_header(payload, None).sections(payload)[1])


def _base_layers(data: memoryview, tile: BaseTile, codebooks: CodebookSet) -> dict[str, PackedCodes]:
    models = {book.attribute: model for book in codebooks if (model := book.model(0)) is not None}
    at, layers = 4 * len(models), dict[str, PackedCodes]()
    sizes = struct.unpack_from(f"<{len(models)}I", data) if len(data) >= at else (len(data),)
    if at + sum(sizes) > len(data):
        raise DecodeError(f"tile: base codes are cut short after {len(data)} bytes")
    for (name, model), size in zip(models.items(), sizes, strict=True):
        layers[name] = decode_codes(data[at : at + size], model, None, tile.near)[1]
        at += size
    packed = {b.attribute: packed_bytes(len(tile), b.layer_bits[0]) for b in codebooks if b.attribute not in models}
    rest, begin = unsqueeze(data[at:], sum(packed.values()), "tile: base codes"), 0
    for name, size in packed.items():
        layers[name] = PackedCodes(rest[begin : begin + size], codebooks[name].layer_bits[0])
        begin += size
    return {book.attribute: layers[book.attribute] for book in codebooks}


def base_parts(payload: bytes | memoryview) -> dict[str, int]:
    """Bytes of a LoD 0 payload by what they tell. Raises :class:`DecodeError`."""
    head = _read_header(payload, None)
    told = {"heads": _BASE_HEADER.size, "ids": head.id_bytes, "positions": head.draco_bytes}
    return told | {"base codes": len(payload) - sum(told.values())}


def decode_base_ids(payload: bytes | memoryview) -> Ids:
    """Only the ids [n] of a LoD 0 payload, without unpacking the rest."""
    return _read_ids(payload, _read_header(payload, None))


def encode_layer(codes: U32, bits: int) -> bytes:
    """One enhancement layer without a model: ``codes`` [n] < 2**bits."""
    return squeeze(pack_bits(codes, bits))


def encode_looks_layer(book: Codebook, layer: int, codes: U32, near: I32 | None) -> bytes:
    """Enhancement ``layer`` >= 1 of a tile of looks, of ``codes`` [n] of full length."""
    own, model = book.layer(codes, layer), book.model(layer)
    if model is None or near is None:
        return encode_layer(own, book.layer_bits[layer])
    return encode_codes(model, own, book.prefix(codes, layer).astype(np.uint8), near)


def encode_position_layer(means: F32, grid: PositionGrid, layer: int) -> bytes:
    """Bit ``layer`` >= 1 of the positions ``means`` [n, 3] below those of LoD 0: a bit an axis, splat by splat."""
    if layer > grid.layers:
        return b""
    bits = grid.quantise(means) >> np.uint32(grid.layers - layer) & np.uint32(1)
    return squeeze(np.packbits(bits.astype(np.uint8), axis=None, bitorder="little").tobytes())


def decode_position_layer(payload: bytes | memoryview, count: int) -> NDArray[np.uint8]:
    """Inverse of :func:`encode_position_layer`: bits [count, 3]. Raises :class:`DecodeError`."""
    if not 0 <= count <= MAX_TILE_SPLATS:
        raise DecodeError(f"layer: positions of {count} splats are outside the allowed range")
    packed = np.frombuffer(unsqueeze(payload, packed_bytes(count, 3), "layer"), np.uint8)
    return np.unpackbits(packed, count=3 * count, bitorder="little").reshape(count, 3)


def decode_layer(payload: bytes | memoryview, count: int, bits: int) -> PackedCodes:
    """Inverse of :func:`encode_layer`: the ``count`` codes. Raises :class:`DecodeError`."""
    if not 1 <= bits <= MAX_LAYER_BITS or not 0 <= count <= MAX_TILE_SPLATS:
        raise DecodeError(f"layer: {count} codes of {bits} bits are outside the allowed range")
    return PackedCodes(unsqueeze(payload, packed_bytes(count, bits), "layer"), bits)


@dataclass(frozen=True, slots=True)
class _Header:
    splats: int
    first_id: int | None
    id_bytes: int
    draco_bytes: int
    grid: PositionGrid

    def sections(self, payload: bytes | memoryview) -> tuple[memoryview, memoryview]:
        """Draco data and base codes."""
        first = _BASE_HEADER.size + self.id_bytes
        end = first + self.draco_bytes
        return memoryview(payload)[first:end], memoryview(payload)[end:]


def _read_header(payload: bytes | memoryview, attributes: int | None) -> _Header:
    if len(payload) < _BASE_HEADER.size:
        raise DecodeError(f"tile: {len(payload)} bytes are too few for a base layer")
    version, flags, bits, columns, splats, id_field, draco, ox, oy, oz, step = _BASE_HEADER.unpack_from(payload)
    layers, flags = flags >> _LAYERS_SHIFT, flags & (1 << _LAYERS_SHIFT) - 1
    if version != BASE_VERSION or flags & ~_ID_RANGE:
        raise DecodeError(f"tile: base layer of version {version}, flags {flags}; this program reads {BASE_VERSION}")
    first_id, id_bytes = (id_field, 0) if flags & _ID_RANGE else (None, id_field)
    many = splats > MAX_TILE_SPLATS or bits > MAX_POSITION_BITS or layers > min(bits, MAX_POSITION_LAYERS)
    if many or id_bytes + draco > len(payload) - _BASE_HEADER.size:
        claims = f"{splats} splats, {bits} position bits, {layers} of them layers, {id_bytes} bytes of ids"
        raise DecodeError(f"tile: claims {claims}, {draco} of positions; beyond bounds")
    if first_id is not None and first_id > MAX_SPLATS - splats:
        raise DecodeError(f"tile: first id {first_id} is beyond {MAX_SPLATS} splats")
    if attributes is not None and columns != attributes:
        raise DecodeError(f"tile: has {columns} attributes, the codebooks {attributes}")
    reach = max(abs(ox), abs(oy), abs(oz)) + step * 2**bits
    if not all(map(math.isfinite, (ox, oy, oz, step))) or step < 0 or reach > MAX_POSITION:
        raise DecodeError(f"tile: its position grid is not finite or reaches beyond {MAX_POSITION:g}")
    grid = PositionGrid(np.array([ox, oy, oz], np.float32), step, bits, layers)
    return _Header(splats, first_id, id_bytes, draco, grid)


def _read_ids(payload: bytes | memoryview, head: _Header) -> Ids:
    if head.first_id is not None:
        return np.arange(head.first_id, head.first_id + head.splats, dtype=np.int32)
    listed = memoryview(payload)[_BASE_HEADER.size : _BASE_HEADER.size + head.id_bytes]
    return decode_ids(listed, what="tile ids", expected=head.splats)


def _draco_encode(cells: F32, bits: int) -> bytes:
    # Draco rounds to a grid of its own: spanned over [0, 2**bits - 1] with that many bits, its grid is the integers.
    encoded: bytes = DracoPy.encode(
        cells,
        quantization_bits=max(bits, 1),
        quantization_range=float(2 ** max(bits, 1) - 1),
        quantization_origin=np.zeros(3),
        compression_level=DRACO_LEVEL,
        preserve_order=True,
    )
    return encoded


def _draco_decode(data: bytes, count: int, grid: PositionGrid) -> F32:
    """Grid coordinates [count, 3] as float32, without the bits of the layers of positions."""
    points = decode_points(data, count)[0].points
    # Damaged data may give a cloud without points, whose ``points`` is None.
    if getattr(points, "shape", None) != (count, 3):
        raise DecodeError("tile: Draco data holds no positions, or some of another shape")
    cells: F32 = np.asarray(points, np.float32)
    if not ((cells >= 0) & (cells < 2.0 ** max(grid.bits - grid.layers, 1))).all():
        raise DecodeError(f"tile: a position is outside its grid of {grid.bits - grid.layers} bits")
    return cells


def _low_and_extent(means: F32) -> tuple[F32, float]:
    if len(means) == 0:
        return np.zeros(3, np.float32), 0.0
    low, high = axis_bounds(means)
    return low, float((high.astype(np.float64) - low).max())
