"""Bytes in and out: bit packing, deflate where it helps, gzip without the clock, ascending id lists, CRC-32.

Everything here is deterministic (same input, same bytes) and every decoder bounds its output before it allocates.
"""

from __future__ import annotations

import gzip
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cags_common.errors import DecodeError
from cags_common.splats import MAX_SPLATS, Ids

U32 = NDArray[np.uint32]

GZIP_LEVEL = 6
"""zlib's own default: levels 7-9 gain under 0.5 % on packed codes and take several times as long."""

WORTH_INFLATING = 0.8
"""Greatest share of its bytes to which a plane must shrink to be deflated by :func:`gzip_planes`."""

_GZIP_HEADER = b"\x1f\x8b\x08" + bytes(6) + b"\xff"
"""RFC 1952: deflate, no flags, no time, unknown system."""

_IDS_HEADER = struct.Struct("<Ii")


def crc32(payload: bytes | memoryview) -> int:
    """CRC-32 (ISO 3309) of a payload, 0 to 2**32 - 1."""
    return zlib.crc32(payload)


def check_crc(payload: bytes | memoryview, crc: int, what: str) -> None:
    """Raise :class:`DecodeError` naming ``what`` when the payload does not have this CRC-32."""
    found = zlib.crc32(payload)
    if found != crc:
        raise DecodeError(f"{what}: CRC-32 is {found:08x}, expected {crc:08x}; the payload was damaged, fetch it again")


def gzip_bytes(data: bytes | memoryview, level: int = GZIP_LEVEL) -> bytes:
    """Gzip without name or time, so that equal data gives equal bytes."""
    return gzip.compress(data, compresslevel=level, mtime=0)


def gzip_planes(planes: Sequence[memoryview], level: int) -> bytes:
    """Gzip of all ``planes`` joined. Planes that deflate would shorten by less than a fifth are stored uncompressed.

    The low bytes of floats are next to random: inflating them takes many times as long as copying them. Repeats across
    two planes are not found.
    """
    out, check, size = [_GZIP_HEADER], 0, 0
    for plane in planes:
        deflated = _deflated(plane, level)
        out.append(deflated if len(deflated) < WORTH_INFLATING * len(plane) else _deflated(plane, 0))
        check, size = zlib.crc32(plane, check), size + len(plane)
    return b"".join([*out, _deflated(b"", 0, zlib.Z_FINISH), struct.pack("<II", check, size & 0xFFFFFFFF)])


def _deflated(data: bytes | memoryview, level: int, end: int = zlib.Z_FULL_FLUSH) -> bytes:
    """Raw deflate blocks that end with a whole byte, so that those of other data may follow."""
    machine = zlib.compressobj(level, zlib.DEFLATED, -zlib.MAX_WBITS)
    return machine.compress(data) + machine.flush(end)


def gzip_numbers(data: bytes) -> bytes:
    """Like :func:`gzip_bytes`, for small numbers that follow no order: repeats of a few bytes are chance."""
    machine = zlib.compressobj(9, zlib.DEFLATED, 16 + zlib.MAX_WBITS, strategy=zlib.Z_FILTERED)
    return machine.compress(data) + machine.flush()


def gunzip_bounded(data: bytes | memoryview, limit_bytes: int, what: str) -> bytes:
    """Inverse of :func:`gzip_bytes`.

    Raises :class:`DecodeError` when damaged or when more than ``limit_bytes`` would come out.
    """
    machine = zlib.decompressobj(wbits=31)
    try:
        out = machine.decompress(data, limit_bytes + 1)
    except zlib.error as error:
        raise DecodeError(f"{what}: is not valid gzip data ({error})") from error
    if len(out) > limit_bytes:
        raise DecodeError(f"{what}: unpacks to more than {limit_bytes} bytes")
    if not machine.eof or machine.unused_data:
        raise DecodeError(f"{what}: gzip data is cut short or followed by other bytes")
    return out


def squeeze(data: bytes) -> bytes:
    """``data`` deflated (RFC 1951) where that is shorter, else as it is; :func:`unsqueeze` tells them by their length.

    Codes of balanced trees are next to random: deflate's frame would cost more than it saves on most layers.
    """
    machine = zlib.compressobj(GZIP_LEVEL, zlib.DEFLATED, -zlib.MAX_WBITS)
    deflated = machine.compress(data) + machine.flush()
    return deflated if len(deflated) < len(data) else data


def unsqueeze(data: bytes | memoryview, size: int, what: str) -> bytes:
    """Inverse of :func:`squeeze` for data of ``size`` bytes. Raises :class:`DecodeError` naming ``what``."""
    if len(data) == size:
        return bytes(data)
    if len(data) > size:
        raise DecodeError(f"{what}: takes {len(data)} bytes, at most {size} are expected")
    machine = zlib.decompressobj(-zlib.MAX_WBITS)
    try:
        out = machine.decompress(data, size + 1)
    except zlib.error as error:
        raise DecodeError(f"{what}: cannot be inflated ({error})") from error
    if len(out) != size or not machine.eof or machine.unused_data:
        raise DecodeError(f"{what}: inflates to other than its {size} bytes")
    return out


def packed_bytes(count: int, bits: int) -> int:
    """Bytes that ``count`` values of ``bits`` bits take."""
    return (count * bits + 7) // 8


def _expansion(bits: int) -> NDArray[np.void] | NDArray[np.unsignedinteger[Any]]:
    """For each byte, its codes as bytes side by side in one word: unpacking is then one look-up a byte."""
    parts = [(np.arange(256) >> shift) & ((1 << bits) - 1) for shift in range(0, 8, bits)]
    codes = np.stack(parts, axis=1).astype(np.uint8)
    return codes.view(f"<u{8 // bits}")[:, 0]


_EXPANDED = {bits: _expansion(bits) for bits in (1, 2, 4, 8)}


def pack_bits(values: U32, bits: int) -> bytes:
    """Pack values [n] < 2**bits, 1 <= bits <= 32, least significant bit first, without gaps."""
    if bits == 8:
        return values.astype(np.uint8).tobytes()
    words = np.ascontiguousarray(values, dtype="<u4").view(np.uint8).reshape(-1, 4)
    used = words[:, : (bits + 7) // 8]
    planes = np.unpackbits(used, axis=1, count=bits, bitorder="little")
    return np.packbits(planes.reshape(-1), bitorder="little").tobytes()


def unpack_bits(data: bytes | memoryview, count: int, bits: int) -> U32:
    """Inverse of :func:`pack_bits`: ``count`` values [n] uint32. Raises :class:`DecodeError` for a wrong length."""
    if len(data) != packed_bytes(count, bits):
        raise DecodeError(f"{count} codes of {bits} bits take {packed_bytes(count, bits)} bytes, not {len(data)}")
    raw = np.frombuffer(data, np.uint8)
    if bits in _EXPANDED:
        spread = _EXPANDED[bits].take(raw)
        return spread.view(np.uint8)[:count].astype(np.uint32)
    planes = np.unpackbits(raw, count=count * bits, bitorder="little").reshape(count, bits)
    width = 8 if bits <= 8 else 32
    padded = np.zeros((count, width), np.uint8)
    padded[:, :bits] = planes
    packed = np.packbits(padded, axis=1, bitorder="little")
    return packed[:, 0].astype(np.uint32) if width == 8 else packed.view("<u4")[:, 0].astype(np.uint32)


@dataclass(frozen=True, slots=True)
class PackedCodes:
    """Codes as :func:`pack_bits` leaves them, not unpacked before they are needed."""

    data: bytes
    bits: int

    def unpack(self, count: int) -> U32:
        """The ``count`` codes [n]. Raises :class:`DecodeError` for a wrong length."""
        return unpack_bits(self.data, count, self.bits)


def encode_ids(ids: Ids) -> bytes:
    """Pack strictly ascending ids [n] >= 0: gaps as four byte planes, gzipped. No ids give no bytes."""
    if len(ids) == 0:
        return b""
    gaps = (np.diff(ids) - 1).astype("<u4")
    planes = np.ascontiguousarray(gaps.view(np.uint8).reshape(-1, 4).T)
    return _IDS_HEADER.pack(len(ids), int(ids[0])) + gzip_bytes(planes.tobytes())


def decode_ids(
    data: bytes | memoryview, *, what: str = "id list", limit: int = MAX_SPLATS, expected: int | None = None
) -> Ids:
    """Inverse of :func:`encode_ids`: [n] int32, strictly ascending, all below ``limit``; ``expected``: how many.

    Raises :class:`DecodeError`, of another number before anything is inflated.
    """
    if 0 < len(data) < _IDS_HEADER.size:
        raise DecodeError(f"{what}: {len(data)} bytes are too few for an id list")
    count, first = _IDS_HEADER.unpack_from(data) if len(data) else (0, 0)
    if expected is not None and count != expected:
        raise DecodeError(f"{what}: claims {count} ids for {expected} splats")
    if len(data) == 0:
        return np.zeros(0, np.int32)
    if not 0 < count <= limit or first < 0:
        raise DecodeError(f"{what}: claims {count} ids from {first}; at most {limit} ids from 0 are allowed")
    raw = gunzip_bounded(memoryview(data)[_IDS_HEADER.size :], 4 * (count - 1), what)
    if len(raw) != 4 * (count - 1):
        raise DecodeError(f"{what}: holds {len(raw)} bytes of gaps, expected {4 * (count - 1)}")
    planes = np.frombuffer(raw, np.uint8).reshape(4, -1)
    gaps = np.ascontiguousarray(planes.T).view("<u4")[:, 0].astype(np.int64)
    ids: NDArray[np.int64] = first + np.concatenate([np.zeros(1, np.int64), np.cumsum(gaps + 1)])
    if ids[-1] >= limit:
        raise DecodeError(f"{what}: id {ids[-1]} is not below {limit}")
    return ids.astype(np.int32)
