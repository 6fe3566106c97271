"""Source frames: the unquantised splats that reference pictures are rendered from (server side only).

The first frame of a group holds all splats, later ones only rows that differ in any bit, and the ids that went.
Lossless: float32 byte planes, gzipped.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common.coding.packing import decode_ids, encode_ids, gunzip_bounded, gzip_bytes
from cags_common.errors import BundleError
from cags_common.geometry import F32
from cags_common.splats import MAX_SPLATS, SH_REST_OF_DEGREE, Ids, Splats

_HEADER = struct.Struct("<BBxxIII")  # version, SH degree, splats, bytes of ids, bytes of removed ids
_VERSION = 1
_FAST = 1
"""gzip level: byte planes of float32 gain 2 % from level 6 and take five times as long."""

ROWS_AT_ONCE = 256
"""Splats whose bytes are put in order together: few enough to stay in a processor's cache."""


@dataclass(frozen=True, eq=False)
class SourceFrame:
    """All splats alive in one frame, unquantised."""

    ids: Ids  # [M] ascending
    splats: Splats  # [M]


@dataclass(frozen=True, eq=False)
class SourceDelta:
    """What one source frame changes against the one before; everything in the first frame of a group."""

    ids: Ids  # [M] ascending
    splats: Splats  # [M]
    removed: Ids  # [R] ascending


def encode_source(delta: SourceDelta) -> bytes:
    """Pack one frame; lossless and deterministic."""
    ids, removed = encode_ids(delta.ids), encode_ids(delta.removed)
    header = _HEADER.pack(_VERSION, delta.splats.sh_degree, len(delta.ids), len(ids), len(removed))
    return header + ids + removed + gzip_bytes(_to_planes(_matrix(delta.splats)), _FAST)


def decode_source(data: bytes | memoryview, what: str) -> SourceDelta:
    """Inverse of :func:`encode_source`. Raises :class:`BundleError` or :class:`DecodeError` naming ``what``."""
    if len(data) < _HEADER.size:
        raise BundleError(f"{what}: is cut short")
    version, degree, count, id_bytes, removed_bytes = _HEADER.unpack_from(data)
    if version != _VERSION or degree > 3 or count > MAX_SPLATS:
        raise BundleError(
            f"{what}: version {version}, SH degree {degree}, {count} splats; beyond what this program reads"
        )
    view = memoryview(data)[_HEADER.size :]
    ids = decode_ids(view[:id_bytes], what=what)
    removed = decode_ids(view[id_bytes : id_bytes + removed_bytes], what=what)
    width = 14 + 3 * SH_REST_OF_DEGREE[degree]
    raw = gunzip_bounded(view[id_bytes + removed_bytes :], 4 * width * count, what)
    if len(ids) != count or len(raw) != 4 * width * count:
        raise BundleError(f"{what}: holds {len(ids)} ids and {len(raw)} bytes of values for {count} splats")
    return SourceDelta(ids, _splats(_from_planes(raw, count, width)), removed)


class SourceState:
    """Replays source frames of one group: rows by id."""

    def __init__(self, capacity: int, sh_degree: int) -> None:
        self._rows: F32 = np.zeros((capacity, 14 + 3 * SH_REST_OF_DEGREE[sh_degree]), np.float32)
        self._alive: NDArray[np.bool_] = np.zeros(capacity, bool)

    def apply(self, delta: SourceDelta) -> None:
        """Take one frame's changes. Raises :class:`BundleError` for ids or an SH degree that do not fit the group."""
        width = 14 + delta.splats.sh_rest.shape[1] * 3
        largest = max((int(ids[-1]) for ids in (delta.ids, delta.removed) if len(ids)), default=-1)
        if width != self._rows.shape[1] or largest >= len(self._alive):
            raise BundleError(
                f"source frame: id {largest} or its SH degree does not fit the group's {len(self._alive)} ids"
            )
        self._alive[delta.removed] = False
        self._rows[delta.ids] = _matrix(delta.splats)
        self._alive[delta.ids] = True

    def frame(self) -> SourceFrame:
        """The splats alive now (copies)."""
        ids = np.flatnonzero(self._alive).astype(np.int32)
        return SourceFrame(ids, _splats(self._rows[ids]))


def _matrix(splats: Splats) -> F32:
    """All values of each splat in one row [n, 14 + 3 K]."""
    columns = (array.reshape(len(splats), int(np.prod(array.shape[1:], dtype=int))) for _, array in splats.arrays())
    return np.concatenate(list(columns), axis=1)


def _splats(rows: F32) -> Splats:
    def part(first: int, end: int | None) -> F32:
        return np.ascontiguousarray(rows[:, first:end])

    rest = part(14, None).reshape(len(rows), (rows.shape[1] - 14) // 3, 3)
    return Splats(part(0, 3), part(3, 7), part(7, 10), part(10, 11)[:, 0].copy(), part(11, 14), rest)


def _to_planes(rows: F32) -> bytes:
    """Bytes of one significance together, column by column: neighbours in Morton order share their high bytes."""
    words = np.ascontiguousarray(rows.T, dtype="<f4")
    return np.ascontiguousarray(words.view(np.uint8).reshape(rows.shape[1], -1, 4).transpose(0, 2, 1)).tobytes()


def _from_planes(raw: bytes, count: int, width: int) -> F32:
    planes = np.frombuffer(raw, np.uint8).reshape(width, 4, count)
    rows = np.empty((count, width), "<f4")
    values = rows.view(np.uint8).reshape(count, width, 4)
    for first in range(0, count, ROWS_AT_ONCE):
        values[first : first + ROWS_AT_ONCE] = planes[:, :, first : first + ROWS_AT_ONCE].transpose(2, 0, 1)
    return rows.astype(np.float32, copy=False)
