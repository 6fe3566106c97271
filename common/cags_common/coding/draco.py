"""Draco point clouds from outside: what the header claims is checked before Draco allocates for it."""

from __future__ import annotations

import struct
from typing import Any

import DracoPy

from cags_common.errors import DecodeError

_DRACO_HEADER = struct.Struct("<5sBBBBHI")  # magic, version (2), geometry type, method, flags, points


def decode_points(data: bytes, count: int) -> tuple[Any, dict[int, Any]]:
    """Draco's cloud of ``count`` points, and its generic attributes by number. Raises :class:`DecodeError`.

    Shapes are the caller's to check: damaged data may give a cloud without points, whose ``points`` is None.
    """
    if len(data) < _DRACO_HEADER.size:
        raise DecodeError("tile: Draco data is cut short")
    magic, _, _, kind, _, flags, points = _DRACO_HEADER.unpack_from(data)
    if magic != b"DRACO" or kind != 0 or flags or points != count:
        raise DecodeError(f"tile: Draco data is not a point cloud of {count} points")
    try:
        cloud = DracoPy.decode(data)
    except (ValueError, RuntimeError, DracoPy.FileTypeException, DracoPy.EncodingFailedException) as error:
        raise DecodeError(f"tile: Draco cannot decode it ({error})") from error
    return cloud, {a["unique_id"]: a["data"] for a in cloud.attributes if a["attribute_type"] != 0}
