"""Source frames: the unquantised splats that reference pictures are rendered from (server side only).

The first frame of a group holds all splats. Each later one holds what changed: all values of splats that appear or
whose scales or colours differ, position, rotation and opacity of splats that differ in these alone, and the ids of
splats that went. Lossless: float32 byte planes in gzip; planes that hardly shrink are stored uncompressed.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common.coding.packing import decode_ids, encode_ids, gunzip_bounded, gzip_planes
from cags_common.errors import BundleError
from cags_common.geometry import F32
from cags_common.splats import MAX_SPLATS, SH_REST_OF_DEGREE, Ids, Splats

_HEADER = struct.Struct("<BBxxIII")  # version, SH degree, splats, bytes of ids, bytes of removed ids
_MOVED = struct.Struct("<II")  # splats that keep their scales and colours, bytes of their ids
_VERSION = 2
_WHOLE_ROWS = 1
"""Earlier version, without moved splats: all values of every splat that differs."""

_PLACE = [*range(7), 10]
"""Columns of position, rotation and opacity."""

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
class Moved:
    """Splats whose scales and colours are those of the frame before."""

    ids: Ids  # [K] ascending
    means: F32  # [K, 3] world, metres
    quats: F32  # [K, 4] wxyz
    logit_opacities: F32  # [K]

    def __len__(self) -> int:
        return len(self.ids)


NOTHING_MOVED = Moved(
    np.zeros(0, np.int32), np.zeros((0, 3), np.float32), np.zeros((0, 4), np.float32), np.zeros(0, np.float32)
)


@dataclass(frozen=True, eq=False)
class SourceDelta:
    """What one source frame changes against the one before; everything in the first frame of a group."""

    ids: Ids  # [M] ascending
    splats: Splats  # [M]
    removed: Ids  # [R] ascending
    moved: Moved = NOTHING_MOVED
    """Splats that only moved or faded; none of them is in ``ids``."""

    @property
    def changes(self) -> bool:
        """Whether the frame differs from the one before."""
        return bool(len(self.ids) or len(self.removed) or len(self.moved))

    def keeping(self, kept: NDArray[np.bool_]) -> SourceDelta:
        """The same change, with the splats that are ``kept`` [M] among ``moved``.

        Their scales and colours must be those of the frame before. Expects that nothing has moved yet.
        """
        s = self.splats
        moved = Moved(self.ids[kept], s.means[kept], s.quats[kept], s.logit_opacities[kept])
        return SourceDelta(self.ids[~kept], s.take(~kept), self.removed, moved)


def encode_source(delta: SourceDelta) -> bytes:
    """Pack one frame; lossless and deterministic."""
    ids, removed, moving = (encode_ids(some) for some in (delta.ids, delta.removed, delta.moved.ids))
    header = _HEADER.pack(_VERSION, delta.splats.sh_degree, len(delta.ids), len(ids), len(removed))
    header += _MOVED.pack(len(delta.moved), len(moving))
    planes = _to_planes(_matrix(delta.splats)) + _to_planes(_places(delta.moved))
    return header + ids + removed + moving + gzip_planes(planes, _FAST)


def decode_source(data: bytes | memoryview, what: str) -> SourceDelta:
    """Inverse of :func:`encode_source`. Raises :class:`BundleError` or :class:`DecodeError` naming ``what``."""
    if len(data) < _HEADER.size:
        raise BundleError(f"{what}: is cut short")
    version, degree, count, id_bytes, removed_bytes = _HEADER.unpack_from(data)
    view, moved, moved_bytes = memoryview(data)[_HEADER.size :], 0, 0
    if version != _WHOLE_ROWS:
        if len(view) < _MOVED.size:
            raise BundleError(f"{what}: is cut short")
        moved, moved_bytes = _MOVED.unpack_from(view)
        view = view[_MOVED.size :]
    if version not in (_WHOLE_ROWS, _VERSION) or degree > 3 or count + moved > MAX_SPLATS:
        raise BundleError(
            f"{what}: version {version}, SH degree {degree}, {count + moved} splats; beyond what this program reads"
        )
    ids, view = decode_ids(view[:id_bytes], what=what), view[id_bytes:]
    removed, view = decode_ids(view[:removed_bytes], what=what), view[removed_bytes:]
    moving = NOTHING_MOVED.ids if version == _WHOLE_ROWS else decode_ids(view[:moved_bytes], what=what)
    width = 14 + 3 * SH_REST_OF_DEGREE[degree]
    whole, places = 4 * width * count, 4 * len(_PLACE) * moved
    raw = gunzip_bounded(view[moved_bytes:], whole + places, what)
    if (len(ids), len(moving), len(raw)) != (count, moved, whole + places):
        raise BundleError(
            f"{what}: holds {len(ids)} + {len(moving)} ids and {len(raw)} bytes of values for {count} + {moved} splats"
        )
    values = memoryview(raw)
    placed = _from_planes(values[whole:], moved, len(_PLACE))
    return SourceDelta(
        ids,
        _splats(_from_planes(values[:whole], count, width)),
        removed,
        Moved(moving, *(np.ascontiguousarray(part) for part in (placed[:, :3], placed[:, 3:7], placed[:, 7]))),
    )


class SourceState:
    """Replays source frames of one group: rows by id."""

    def __init__(self, capacity: int, sh_degree: int) -> None:
        self._rows: F32 = np.zeros((capacity, 14 + 3 * SH_REST_OF_DEGREE[sh_degree]), np.float32)
        self._alive: NDArray[np.bool_] = np.zeros(capacity, bool)

    def apply(self, delta: SourceDelta) -> None:
        """Take one frame's changes. Raises :class:`BundleError` for ids or an SH degree that do not fit the group."""
        width = 14 + delta.splats.sh_rest.shape[1] * 3
        lists = (delta.ids, delta.removed, delta.moved.ids)
        largest = max((int(ids[-1]) for ids in lists if len(ids)), default=-1)
        if width != self._rows.shape[1] or largest >= len(self._alive):
            raise BundleError(
                f"source frame: id {largest} or its SH degree does not fit the group's {len(self._alive)} ids"
            )
        self._alive[delta.removed] = False
        self._rows[delta.ids] = _matrix(delta.splats)
        self._alive[delta.ids] = True
        self._rows[np.ix_(delta.moved.ids, _PLACE)] = _places(delta.moved)

    def frame(self) -> SourceFrame:
        """The splats alive now (copies)."""
        ids = np.flatnonzero(self._alive).astype(np.int32)
        return SourceFrame(ids, _splats(self._rows[ids]))


def _matrix(splats: Splats) -> F32:
    """All values of each splat in one row [n, 14 + 3 K]."""
    columns = (array.reshape(len(splats), int(np.prod(array.shape[1:], dtype=int))) for _, array in splats.arrays())
    return np.concatenate(list(columns), axis=1)


def _places(moved: Moved) -> F32:
    """Position, rotation and opacity of each in one row [n, 8]."""
    return np.concatenate([moved.means, moved.quats, moved.logit_opacities[:, None]], axis=1)


def _splats(rows: F32) -> Splats:
    def part(first: int, end: int | None) -> F32:
        return np.ascontiguousarray(rows[:, first:end])

    rest = part(14, None).reshape(len(rows), (rows.shape[1] - 14) // 3, 3)
    return Splats(part(0, 3), part(3, 7), part(7, 10), part(10, 11)[:, 0].copy(), part(11, 14), rest)


def _to_planes(rows: F32) -> list[memoryview]:
    """Bytes of one significance together, column by column: neighbours in Morton order share their high bytes."""
    words = np.ascontiguousarray(rows.T, dtype="<f4")
    planes = np.ascontiguousarray(words.view(np.uint8).reshape(rows.shape[1], -1, 4).transpose(0, 2, 1))
    return [plane.data for plane in planes.reshape(-1, len(rows))] if len(rows) else []


def _from_planes(raw: bytes | memoryview, count: int, width: int) -> F32:
    planes = np.frombuffer(raw, np.uint8).reshape(width, 4, count)
    rows = np.empty((count, width), "<f4")
    values = rows.view(np.uint8).reshape(count, width, 4)
    for first in range(0, count, ROWS_AT_ONCE):
        values[first : first + ROWS_AT_ONCE] = planes[:, :, first : first + ROWS_AT_ONCE].transpose(2, 0, 1)
    return rows.astype(np.float32, copy=False)
