"""Byte planes through H.264: what a video codec makes of numbers that are no picture.

Values of one tile lie in Morton order; on each plane they follow a Z-curve, so that neighbours in space are neighbours
on the plane. All planes of a tile are stacked in one monochrome intra picture.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise

import av
import numpy as np
from av.error import FFmpegError
from av.video.frame import VideoFrame
from numpy.typing import NDArray

from cags_common.errors import DecodeError
from cags_common.tiles.payloads import MAX_TILE_SPLATS
from cags_research.codecs.scalar import U8

MAX_PLANES = 64

SEI = 6
"""Type of H.264's units of supplemental information."""

_START = re.compile(rb"\x00?\x00\x00\x01")


def plane_shape(count: int) -> tuple[int, int]:
    """Height and width of the plane that holds ``count`` >= 1 values: a square power of two or half of one."""
    bits = max(int(count - 1).bit_length(), 8)
    return 1 << (bits // 2), 1 << (bits - bits // 2)


def z_curve(count: int) -> NDArray[np.intp]:
    """Pixel [count] of each value, row by row, along the Z-curve."""
    index = np.arange(count, dtype=np.int64)
    column, row = np.zeros(count, np.int64), np.zeros(count, np.int64)
    for bit in range(12):
        column |= (index >> (2 * bit) & 1) << bit
        row |= (index >> (2 * bit + 1) & 1) << bit
    return (row * plane_shape(count)[1] + column).astype(np.intp)


def encode_planes(values: U8, crf: int) -> bytes:
    """``values`` [n, planes] as one intra access unit; ``crf`` is x264's constant quality, 0 (lossless) to 51."""
    return encode_plane_video([values], crf)[0]


def encode_plane_video(frames: Sequence[U8], crf: int) -> list[bytes]:
    """``values`` [n, planes] of each frame, the later ones predicted from those before: an access unit each."""
    count, planes = frames[0].shape
    height, width = plane_shape(count)
    context = av.CodecContext.create("libx264", "w")
    context.width, context.height, context.pix_fmt = width, planes * height, "gray"
    context.time_base, context.thread_count = Fraction(1, 30), 1
    context.options = {"crf": str(crf), "preset": "medium", "tune": "zerolatency", "x264-params": "annexb=1"}
    units = []
    for pts, values in enumerate(frames):
        frame = VideoFrame.from_ndarray(_stacked(values), format="gray")
        frame.pts = pts
        units += [bytes(packet) for packet in context.encode(frame)]
    units += [bytes(packet) for packet in context.encode(None)]
    assert len(units) == len(frames), "no frame waits for another"
    return [_without_notes(unit) for unit in units]


def _without_notes(unit: bytes) -> bytes:
    """An access unit less what x264 says of itself: 600 bytes in each tile, of which no decoder takes any notice."""
    starts = [found.start() for found in _START.finditer(unit)]
    parts = (unit[a:b] for a, b in pairwise([*starts, len(unit)]))
    return b"".join(part for part in parts if part[part.index(1) + 1] & 31 != SEI)


def _stacked(values: U8) -> U8:
    """The planes of ``values`` [n, planes] under one another [planes * height, width]."""
    count, planes = values.shape
    height, width = plane_shape(count)
    picture = np.empty((planes, height * width), np.uint8)
    picture[:] = np.round(values.mean(axis=0)).astype(np.uint8)[:, None]  # pixels without a value cost little so
    picture[:, z_curve(count)] = values.T
    return picture.reshape(planes * height, width)


def decode_planes(data: bytes, count: int, planes: int) -> U8:
    """Inverse of :func:`encode_planes`: [count, planes], lossy. Raises :class:`DecodeError`."""
    if not 1 <= count <= MAX_TILE_SPLATS or not 1 <= planes <= MAX_PLANES:
        raise DecodeError(f"planes: {planes} planes of {count} values are outside the allowed range")
    height, width = plane_shape(count)
    context = av.CodecContext.create("h264", "r")
    context.thread_count = 1
    context.options = {"max_pixels": str(2 * planes * height * width + 65536)}
    try:
        frames = [*context.decode(av.Packet(data)), *context.decode(None)]
    except FFmpegError as error:
        raise DecodeError(f"planes: H.264 cannot decode them ({error.strerror})") from error
    if len(frames) != 1 or (frames[0].width, frames[0].height) != (width, planes * height):
        raise DecodeError(f"planes: expected one picture of {width}x{planes * height} pixels")
    luma = frames[0].planes[0]
    rows = np.frombuffer(memoryview(luma), np.uint8).reshape(-1, luma.line_size)[: planes * height, :width]
    return np.ascontiguousarray(rows.reshape(planes, height * width)[:, z_curve(count)].T)
