"""Points with byte attributes through Draco, and the head that baseline tiles share: ids and the position grid."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import DracoPy
import numpy as np
from numpy.typing import NDArray

from cags_common.coding.draco import decode_points
from cags_common.coding.packing import U32, decode_ids, encode_ids
from cags_common.errors import DecodeError
from cags_common.splats import MAX_SPLATS, Ids
from cags_common.tiles.payloads import DRACO_LEVEL, MAX_POSITION_BITS, MAX_TILE_SPLATS, PositionGrid
from cags_research.codecs.scalar import U8

_HEAD = struct.Struct("<4sBBHII4f")
"""Codec, id range or list, position bits, reserved, splats, first id or bytes of the id list, grid origin and step."""

MAX_REACH = 1e30
"""Largest coordinate, world units; sums of such still fit float32."""


@dataclass(frozen=True, eq=False)
class TileHead:
    """Whose splats a tile holds and on which grid they lie."""

    ids: Ids  # [n] ascending
    grid: PositionGrid
    size: int
    """Bytes that the head took."""


def encode_head(kind: bytes, ids: Ids, grid: PositionGrid, *, id_range: bool) -> bytes:
    """The head of a tile of codec ``kind`` (four bytes). With ``id_range`` the ids [n] are consecutive."""
    listed = b"" if id_range else encode_ids(ids)
    field = int(ids[0]) if id_range else len(listed)
    ox, oy, oz = (float(c) for c in grid.origin)
    return _HEAD.pack(kind, id_range, grid.bits, 0, len(ids), field, ox, oy, oz, grid.step) + listed


def decode_head(payload: bytes | memoryview, kind: bytes) -> TileHead:
    """Inverse of :func:`encode_head`. Raises :class:`DecodeError`."""
    if len(payload) < _HEAD.size:
        raise DecodeError(f"tile: {len(payload)} bytes are too few for its head")
    found, id_range, bits, _, count, field, ox, oy, oz, step = _HEAD.unpack_from(payload)
    if found != kind:
        raise DecodeError(f"tile: is of codec {found!r}, expected {kind!r}")
    if id_range > 1 or not 1 <= count <= MAX_TILE_SPLATS or not 1 <= bits <= MAX_POSITION_BITS:
        raise DecodeError(f"tile: claims {count} splats with {bits} position bits; beyond bounds")
    if not all(abs(c) <= MAX_REACH for c in (ox, oy, oz)) or not 0 <= step * 2**bits <= MAX_REACH:
        raise DecodeError(f"tile: its position grid reaches beyond {MAX_REACH:g}")
    listed = 0 if id_range else field
    if (id_range and field > MAX_SPLATS - count) or listed > len(payload) - _HEAD.size:
        raise DecodeError(f"tile: its ids reach beyond {MAX_SPLATS} or its end")
    end = _HEAD.size + listed
    ids = (
        np.arange(field, field + count, dtype=np.int32)
        if id_range
        else decode_ids(memoryview(payload)[_HEAD.size : end])
    )
    if len(ids) != count:
        raise DecodeError(f"tile: has {len(ids)} ids for {count} splats")
    return TileHead(ids, PositionGrid(np.array([ox, oy, oz], np.float32), step, bits), end)


def encode_cloud(cells: U32, columns: Sequence[U8], bits: int) -> bytes:
    """Grid coordinates [n, 3] and byte attributes [n, dim], n >= 1, in this order; nothing is lost."""
    encoded: bytes = DracoPy.encode(
        cells.astype(np.float32),
        quantization_bits=bits,
        quantization_range=float(2**bits - 1),  # Draco's own grid is the integers then
        quantization_origin=np.zeros(3),
        compression_level=DRACO_LEVEL,
        preserve_order=True,
        generic_attributes=dict(enumerate(columns)),
    )
    return encoded


def decode_cloud(data: bytes, count: int, dims: Sequence[int]) -> tuple[NDArray[np.float32], list[U8]]:
    """Inverse of :func:`encode_cloud`: coordinates [count, 3], attributes [count, dim]. Raises :class:`DecodeError`."""
    cloud, columns = decode_points(data, count)
    found = [columns.get(i) for i in range(len(dims))]
    for column, dim in zip(found, dims, strict=True):
        if column is None or column.shape != (count, dim) or column.dtype != np.uint8:
            raise DecodeError("tile: Draco data lacks an attribute or holds one of another shape")
    if getattr(cloud.points, "shape", None) != (count, 3) or not np.isfinite(cloud.points).all():
        raise DecodeError("tile: Draco data holds no finite positions")
    return cloud.points, [column for column in found if column is not None]
