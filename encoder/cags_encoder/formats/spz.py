"""Niantic's ``.spz``: a header and one section of bytes per attribute, in one gzip stream up to version 3.

Positions are 24-bit fixed point (float16 in version 1). Rotations have three bytes (xyz) or, from version 3, the
smallest three components in ten bits each. Frame: right, up, back (y up).
Described by https://github.com/nianticlabs/spz
"""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cags_common.errors import SceneError
from cags_common.geometry import F32
from cags_common.splats import Splats
from cags_encoder.formats.files import (
    bytes_of_logits,
    directed,
    logit_of_bytes,
    quietly,
    smallest_three,
    split_largest,
)
from cags_encoder.formats.repair import Check
from cags_encoder.formats.spz_header import MAGIC, SpzHeader, checked_header
from cags_encoder.formats.spz_streams import inflate_streams

HEADER = struct.Struct("<IIIBBBB")
COLOUR_SCALE = 0.15
"""Colours outside 0..1 are kept: a byte covers more than the displayable range."""

GZIP_WBITS = 31


@quietly
def parse_spz(data: bytes, source: str, check: Check = Splats.checked) -> Splats:
    """Splats from the bytes of an ``.spz`` file; ``source`` names it in errors. Raises :class:`SceneError`."""
    header, part = _inflate(data, source)
    quats = _smallest_three(part["quat"]) if header.version >= 3 else _xyz_quats(part["quat"])
    splats = Splats(
        means=_means(part["mean"], header),
        quats=directed(quats),
        log_scales=part["scale"].astype(np.float32) / np.float32(16.0) - np.float32(10.0),
        logit_opacities=logit_of_bytes(part["alpha"][:, 0]),
        sh0=_colours(part["colour"]),
        sh_rest=((part["sh"].astype(np.float32) - 128.0) / np.float32(128.0)).reshape(header.count, -1, 3),
    )
    return check(splats, source)


def _inflate(data: bytes, source: str) -> tuple[SpzHeader, dict[str, NDArray[np.uint8]]]:
    """The header and the sections [count, bytes per splat]. Inflates no more than the size given by the header."""
    if data[:4] == struct.pack("<I", MAGIC):
        return inflate_streams(data, source)
    inflater = zlib.decompressobj(GZIP_WBITS)
    try:
        head = inflater.decompress(data, HEADER.size)
        header = _header(head, source, len(data))
        size = header.count * sum(width for _, width in header.sections)
        body = inflater.decompress(inflater.unconsumed_tail, size)
        more = inflater.decompress(inflater.unconsumed_tail, 1)  # reaches the checksum of the stream
    except zlib.error as error:
        raise SceneError(f"{source}: is not a gzip stream or is damaged ({error}); check the file's type") from error
    if len(body) < size or not (more or inflater.eof):
        raise SceneError(f"{source}: is cut short: {header.count} splats take {size} bytes, the file has {len(body)}")
    parts, offset = {}, 0
    for name, width in header.sections:
        parts[name] = np.frombuffer(body, np.uint8, header.count * width, offset).reshape(header.count, width)
        offset += header.count * width
    return header, parts


def _header(head: bytes, source: str, held_bytes: int) -> SpzHeader:
    if len(head) < HEADER.size:
        raise SceneError(f"{source}: is cut short in its header")
    magic, version, count, sh_degree, fractional_bits, _flags, _reserved = HEADER.unpack(head)
    if magic != MAGIC:
        raise SceneError(f"{source}: is gzip, but not SPZ (magic 0x{magic:08x}); check the file's type")
    if version not in (1, 2, 3):
        raise SceneError(f"{source}: is SPZ version {version} in gzip; versions 1 to 3 are supported")
    return checked_header(version, count, sh_degree, fractional_bits, source, held_bytes=held_bytes)


def _means(raw: NDArray[np.uint8], header: SpzHeader) -> F32:
    if header.version == 1:
        return np.ascontiguousarray(raw).view("<f2").astype(np.float32)
    low, middle, high = (raw.reshape(header.count, 3, 3)[:, :, i].astype(np.int32) for i in range(3))
    fixed = low | (middle << 8) | ((high ^ 0x80) - 0x80) << 16  # the sign is the top bit of the highest byte
    return (fixed / (1 << header.fractional_bits)).astype(np.float32)


def _colours(raw: NDArray[np.uint8]) -> F32:
    return (raw.astype(np.float32) / np.float32(255.0) - np.float32(0.5)) / np.float32(COLOUR_SCALE)


def _xyz_quats(raw: NDArray[np.uint8]) -> F32:
    xyz = raw / np.float32(127.5) - np.float32(1.0)
    w = np.sqrt(np.maximum(0.0, 1.0 - np.sum(np.square(xyz), axis=1, keepdims=True)))
    return np.concatenate([w, xyz], axis=1).astype(np.float32)


def _smallest_three(raw: NDArray[np.uint8]) -> F32:
    """The top bits give the index of the largest of xyzw; each other component has a sign bit and nine bits."""
    words = np.ascontiguousarray(raw).view("<u4")[:, 0]
    fields = np.stack([(words >> np.uint32(shift)) & np.uint32(1023) for shift in (20, 10, 0)], axis=1)
    magnitude = (fields & 511).astype(np.float32) * np.float32(np.sqrt(0.5) / 511.0)
    xyzw = smallest_three((words >> np.uint32(30)).astype(np.intp), np.where(fields & 512, -magnitude, magnitude))
    return xyzw[:, [3, 0, 1, 2]]


def spz_bytes(splats: Splats) -> bytes:
    """An ``.spz`` file (version 3) of ``splats`` in their order, with the most fractional bits that positions allow."""
    bits = _fractional_bits(splats)
    head = HEADER.pack(MAGIC, 3, len(splats), splats.sh_degree, bits, 0, 0)
    fixed = np.clip(np.round(splats.means.astype(np.float64) * (1 << bits)), -(2**23), 2**23 - 1).astype("<i4")
    parts: list[NDArray[Any]] = [
        fixed[:, :, None].view(np.uint8)[:, :, :3],
        bytes_of_logits(splats.logit_opacities),
        _rounded((splats.sh0 * COLOUR_SCALE + 0.5) * 255.0),
        _rounded((splats.log_scales + 10.0) * 16.0),
        _pack_smallest_three(splats.quats),
        _rounded(splats.sh_rest * 128.0 + 128.0),
    ]
    packer = zlib.compressobj(9, zlib.DEFLATED, GZIP_WBITS)  # no time stamp: the same splats give the same bytes
    return packer.compress(head + b"".join(part.tobytes() for part in parts)) + packer.flush()


def quantised_as_spz(splats: Splats) -> Splats:
    """``splats`` in their order after a round trip through an ``.spz`` file of Niantic's tools.

    These tools keep 5 bits of harmonics of degree 1 and 4 of higher degrees; :func:`spz_bytes` keeps 8.
    """
    scale = float(1 << _fractional_bits(splats))
    fixed = np.clip(np.round(splats.means.astype(np.float64) * scale), -(2**23), 2**23 - 1)
    buckets = np.where(np.arange(splats.sh_rest.shape[1]) < 3, 8.0, 16.0)[:, None] / 128.0
    return Splats(
        means=(fixed / scale).astype(np.float32),
        quats=_smallest_three(_pack_smallest_three(splats.quats)[:, None].view(np.uint8)),
        log_scales=_rounded((splats.log_scales + 10.0) * 16.0).astype(np.float32) / np.float32(16.0) - np.float32(10.0),
        logit_opacities=logit_of_bytes(bytes_of_logits(splats.logit_opacities)),
        sh0=_colours(_rounded((splats.sh0 * COLOUR_SCALE + 0.5) * 255.0)),
        sh_rest=np.clip(np.round(splats.sh_rest / buckets) * buckets, -1.0, 127 / 128).astype(np.float32),
    )


def _fractional_bits(splats: Splats) -> int:
    """Number of fractional bits, of 24, that the largest coordinate leaves."""
    reach = max(float(np.abs(splats.means).max()), 1e-6)
    return int(np.clip(np.floor(np.log2((2**23 - 1) / reach)), 0, 24))


def _rounded(values: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    return np.clip(np.round(values), 0, 255).astype(np.uint8)


def _pack_smallest_three(quats: F32) -> NDArray[np.uint32]:
    largest, others = split_largest(quats[:, [1, 2, 3, 0]])
    magnitude = np.minimum(np.round(np.abs(others) * np.sqrt(2.0) * 511.0), 511).astype(np.uint32)
    fields = magnitude | np.where(others < 0, np.uint32(512), np.uint32(0))
    packed = (largest.astype(np.uint32) << np.uint32(30)) | (fields[:, 0] << np.uint32(20))
    words: NDArray[np.uint32] = (packed | (fields[:, 1] << np.uint32(10)) | fields[:, 2]).astype("<u4")
    return words
