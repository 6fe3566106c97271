"""The container of ``.spz`` version 4: a header, a table of sizes, and one zstd stream per section.

The sections are those of version 3. Described by https://github.com/nianticlabs/spz
"""

from __future__ import annotations

import struct

import numpy as np
import zstandard
from numpy.typing import NDArray

from cags_common.errors import SceneError
from cags_encoder.formats.spz_header import SpzHeader, checked_header

HEADER = struct.Struct("<IIIBBBBI12x")
"""Magic, version, splats, SH degree, fractional bits, flags, streams, offset of the table; twelve reserved bytes."""

ENTRY = struct.Struct("<QQ")
"""Compressed and uncompressed size of a stream, in bytes."""

MAX_WINDOW_BYTES = 1 << 27
"""Largest zstd window accepted: that of compression level 22."""


def inflate_streams(data: bytes, source: str) -> tuple[SpzHeader, dict[str, NDArray[np.uint8]]]:
    """The header and the sections [count, bytes per splat] of a version 4 file. Raises :class:`SceneError`."""
    if len(data) < HEADER.size:
        raise SceneError(f"{source}: is cut short in its header")
    _, version, count, degree, bits, _, streams, table = HEADER.unpack_from(data)
    if version != 4:
        raise SceneError(
            f"{source}: is SPZ version {version} in streams; versions 1 to 4 are supported; save it as version 3"
        )
    header = checked_header(version, count, degree, bits, source, held_bytes=len(data))
    sections = [(name, width) for name, width in header.sections if width]
    if streams != len(sections):
        raise SceneError(f"{source}: has {streams} streams; SH degree {degree} needs {len(sections)}")
    at = table + streams * ENTRY.size
    if table < HEADER.size or at > len(data):
        raise SceneError(f"{source}: its table of streams lies outside the file; the file is cut short or damaged")
    parts = {name: np.zeros((count, width), np.uint8) for name, width in header.sections if not width}
    for row, (name, width) in enumerate(sections):
        packed, size = ENTRY.unpack_from(data, table + row * ENTRY.size)
        if size != count * width:
            raise SceneError(f"{source}: {name} claims {size} bytes; {count} splats take {count * width}")
        if packed > len(data) - at:
            raise SceneError(f"{source}: is cut short: {name} takes {packed} bytes, {len(data) - at} are left")
        raw = _inflate(data[at : at + packed], size, f"{source}: {name}")
        parts[name] = np.frombuffer(raw, np.uint8).reshape(count, width)
        at += packed
    return header, parts


def _inflate(data: bytes, size: int, what: str) -> bytes:
    """Decompress ``size`` bytes. The size given in the stream is checked before memory is allocated for it."""
    try:
        frame = zstandard.get_frame_parameters(data)
        known = frame.content_size != zstandard.CONTENTSIZE_UNKNOWN
        if (known and frame.content_size != size) or frame.window_size > MAX_WINDOW_BYTES:
            raise SceneError(f"{what} is packed for {frame.content_size} bytes, not {size}; the file is damaged")
        raw = zstandard.ZstdDecompressor(max_window_size=MAX_WINDOW_BYTES).decompress(data, max_output_size=size)
    except zstandard.ZstdError as error:
        text = " ".join(str(error).split())
        raise SceneError(f"{what} is not a zstd stream or is damaged ({text}); check the file") from error
    if len(raw) != size:
        raise SceneError(f"{what} unpacks to {len(raw)} bytes, not {size}; the file is damaged")
    return raw
