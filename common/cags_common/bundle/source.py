"""Source frames: the unquantised splats that reference pictures are rendered from (server side only).

The first frame of a group holds all splats. Each later one holds what changed: all values of splats that appear or
whose scales or colours differ, position, rotation and opacity of splats that differ in these alone, and the ids of
splats that went. Lossless: float32 byte planes in gzip; planes that hardly shrink are stored uncompressed. Scales and
colours are packed apart from position, rotation and opacity, so that a reader that skips frames reads the newest ones
only.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cags_common.coding.packing import decode_ids, encode_ids, gunzip_bounded, gzip_planes
from cags_common.errors import BundleError
from cags_common.geometry import F32
from cags_common.splats import MAX_SPLATS, SH_REST_OF_DEGREE, Ids, Splats

_HEADER = struct.Struct("<BBxx8I")
"""Version, SH degree; splats, removed and moved ones, bytes of the ids of each, of scales and colours, of places."""

_VERSION = 3
_PLACE_COLUMNS = 8
"""Position, rotation and opacity."""

_FAST = 1
"""gzip level: byte planes of float32 gain 2 % from level 6 and take five times as long."""

Read: TypeAlias = Callable[[int, int], "bytes | memoryview"]
"""Gives bytes [first, end) of a packed change."""

_Source: TypeAlias = tuple[Read, str]
"""What reads a packed change, and its name for errors."""

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
class SourceLooks:
    """Scales and colours."""

    log_scales: F32  # [M, 3]
    sh0: F32  # [M, 3]
    sh_rest: F32  # [M, K, 3]


class SourceDelta:
    """What one source frame changes against the one before; everything in the first frame of a group."""

    def __init__(self, ids: Ids, splats: Splats, removed: Ids, moved: Moved = NOTHING_MOVED) -> None:
        """``splats`` [M] of the ids [M], ascending, and those that only ``moved`` or faded; none is both."""
        self.ids, self.removed = ids, removed
        self._splats, self._moved = splats, moved

    @property
    def splats(self) -> Splats:
        """[M] by :attr:`ids`."""
        return self._splats

    @property
    def moved(self) -> Moved:
        """Splats that only moved or faded; none of them is in :attr:`ids`."""
        return self._moved

    @property
    def moved_ids(self) -> Ids:
        """[K] those of :attr:`moved`."""
        return self._moved.ids

    @property
    def looks(self) -> SourceLooks:
        """[M] of :attr:`splats`."""
        return SourceLooks(self._splats.log_scales, self._splats.sh0, self._splats.sh_rest)

    @property
    def places(self) -> F32:
        """[M + K, 8] position, rotation and opacity logit of :attr:`splats`, then of :attr:`moved`."""
        parts = [
            np.concatenate([of.means, of.quats, of.logit_opacities[:, None]], axis=1)
            for of in (self._splats, self._moved)
        ]
        return np.concatenate(parts)

    @property
    def changes(self) -> bool:
        """Whether the frame differs from the one before."""
        return bool(len(self.ids) or len(self.removed) or len(self.moved_ids))

    @property
    def nbytes(self) -> int:
        """Memory."""
        m = self._moved
        arrays = (self.ids, self.removed, m.ids, m.means, m.quats, m.logit_opacities)
        return sum(array.nbytes for array in (*arrays, *(values for _, values in self._splats.arrays())))

    def keeping(self, kept: NDArray[np.bool_]) -> SourceDelta:
        """The same change, with the splats that are ``kept`` [M] among ``moved``.

        Their scales and colours must be those of the frame before. Expects that nothing has moved yet.
        """
        s = self.splats
        moved = Moved(self.ids[kept], s.means[kept], s.quats[kept], s.logit_opacities[kept])
        return SourceDelta(self.ids[~kept], s.take(~kept), self.removed, moved)


class PackedDelta(SourceDelta):
    """A change as it is stored: values are read when they are asked for first, which may raise :class:`BundleError` or
    :class:`DecodeError`.
    """

    def __init__(self, who: tuple[Ids, Ids, Ids], degree: int, parts: tuple[range, range], source: _Source) -> None:
        """``who``: the ids that changed, went and moved; ``parts``: where the values of looks and of places are."""
        self.ids, self.removed, self._moved_ids = who
        self._degree, self._parts, self._source = degree, parts, source
        self._looks: SourceLooks | None = None
        self._places: F32 | None = None

    @property
    def packed_bytes(self) -> int:
        """Of the whole change."""
        return self._parts[1].stop

    @property
    def splats(self) -> Splats:
        """[M] by :attr:`ids`."""
        looks, (means, quats, logits) = self.looks, _parts(self.places[: len(self.ids)])
        return Splats(means, quats, looks.log_scales, logits, looks.sh0, looks.sh_rest)

    @property
    def moved(self) -> Moved:
        """Splats that only moved or faded."""
        return Moved(self._moved_ids, *_parts(self.places[len(self.ids) :]))

    @property
    def moved_ids(self) -> Ids:
        """[K] those of :attr:`moved`."""
        return self._moved_ids

    @property
    def looks(self) -> SourceLooks:
        """[M] of :attr:`splats`."""
        found = self._looks
        if found is None:
            rows = self._unpacked(0, len(self.ids), _look_columns(self._degree))
            rest = np.ascontiguousarray(rows[:, 6:]).reshape(len(rows), SH_REST_OF_DEGREE[self._degree], 3)
            found = SourceLooks(np.ascontiguousarray(rows[:, :3]), np.ascontiguousarray(rows[:, 3:6]), rest)
            self._looks = found
        return found

    @property
    def places(self) -> F32:
        """[M + K, 8] position, rotation and opacity logit of :attr:`splats`, then of :attr:`moved`."""
        found = self._places
        if found is None:
            found = self._unpacked(1, len(self.ids) + len(self._moved_ids), _PLACE_COLUMNS)
            self._places = found
        return found

    def _unpacked(self, part: int, count: int, width: int) -> F32:
        where, (read, what) = self._parts[part], self._source
        raw = gunzip_bounded(read(where.start, where.stop), 4 * width * count, what)
        if len(raw) != 4 * width * count:
            raise BundleError(f"{what}: holds {len(raw)} bytes of values for {count} splats")
        return _from_planes(raw, count, width)

    @property
    def nbytes(self) -> int:
        """Memory, of everything unpacked."""
        looks, places = len(self.ids), len(self.ids) + len(self._moved_ids)
        ids = self.ids.nbytes + self.removed.nbytes + self._moved_ids.nbytes
        return ids + 4 * (looks * _look_columns(self._degree) + places * _PLACE_COLUMNS)


def encode_source(delta: SourceDelta) -> bytes:
    """Pack one frame; lossless and deterministic."""
    lists = delta.ids, delta.removed, delta.moved_ids
    coded = [encode_ids(some) for some in lists]
    looks = delta.looks
    columns = [looks.log_scales, looks.sh0, looks.sh_rest.reshape(len(looks.sh0), 3 * looks.sh_rest.shape[1])]
    packed = [gzip_planes(_to_planes(rows), _FAST) for rows in (np.concatenate(columns, axis=1), delta.places)]
    counts = [*map(len, lists), *map(len, coded), *map(len, packed)]
    return b"".join([_HEADER.pack(_VERSION, delta.splats.sh_degree, *counts), *coded, *packed])


def head_bytes(data: bytes) -> int:
    """Size of the header and id lists of a packed change, after which its values follow."""
    if len(data) < _HEADER.size:
        return len(data)
    sizes: tuple[int, ...] = _HEADER.unpack_from(data)[5:8]
    return min(_HEADER.size + sum(sizes), len(data))


def decode_source(data: bytes | memoryview, what: str, read: Read | None = None) -> PackedDelta:
    """Inverse of :func:`encode_source`. Raises :class:`BundleError` or :class:`DecodeError` naming ``what``.

    ``data`` may be the first :func:`head_bytes` alone where ``read(first, end)`` gives other bytes of the whole.
    """
    if len(data) < _HEADER.size:
        raise BundleError(f"{what}: is cut short")
    version, degree, *numbers = _HEADER.unpack_from(data)
    counts, sizes, values = numbers[:3], numbers[3:6], numbers[6:]
    if version != _VERSION or degree > 3 or sum(counts) > 2 * MAX_SPLATS:
        raise BundleError(
            f"{what}: version {version}, SH degree {degree}, {sum(counts)} splats; beyond what this program reads"
        )
    view, at, lists = memoryview(data), _HEADER.size, []
    for size, count in zip(sizes, counts, strict=True):
        lists.append(decode_ids(view[at : at + size], what=what, expected=count))
        at += size
    parts = range(at, at + values[0]), range(at + values[0], at + sum(values))
    source = read or (lambda first, end: view[first:end]), what
    return PackedDelta((lists[0], lists[1], lists[2]), degree, parts, source)


def _look_columns(degree: int) -> int:
    return 6 + 3 * SH_REST_OF_DEGREE[degree]


def _parts(places: F32) -> tuple[F32, F32, F32]:
    """Positions, rotations and opacity logits of rows [n, 8]."""
    means, quats = np.ascontiguousarray(places[:, :3]), np.ascontiguousarray(places[:, 3:7])
    return means, quats, np.ascontiguousarray(places[:, 7])


class SourceState:
    """Replays source frames of one group: rows by id."""

    def __init__(self, capacity: int, sh_degree: int) -> None:
        self._places: F32 = np.zeros((capacity, _PLACE_COLUMNS), np.float32)
        rest = np.zeros((capacity, SH_REST_OF_DEGREE[sh_degree], 3), np.float32)
        self._looks = SourceLooks(np.zeros((capacity, 3), np.float32), np.zeros((capacity, 3), np.float32), rest)
        self._alive: NDArray[np.bool_] = np.zeros(capacity, bool)

    def apply(self, delta: SourceDelta) -> None:
        """Take one frame's changes. Raises :class:`BundleError` for ids or an SH degree that do not fit the group."""
        held, looks = self._looks, delta.looks
        lists = (delta.ids, delta.removed, delta.moved_ids)
        largest = max((int(ids[-1]) for ids in lists if len(ids)), default=-1)
        if looks.sh_rest.shape[1] != held.sh_rest.shape[1] or largest >= len(self._alive):
            raise BundleError(
                f"source frame: id {largest} or its SH degree does not fit the group's {len(self._alive)} ids"
            )
        self._alive[delta.removed] = False
        self._alive[delta.ids] = True
        held.log_scales[delta.ids], held.sh0[delta.ids] = looks.log_scales, looks.sh0
        held.sh_rest[delta.ids] = looks.sh_rest
        self._places[np.concatenate([delta.ids, delta.moved_ids])] = delta.places

    def frame(self) -> SourceFrame:
        """The splats alive now (copies)."""
        ids, looks = np.flatnonzero(self._alive).astype(np.int32), self._looks
        means, quats, logits = _parts(self._places[ids])
        return SourceFrame(ids, Splats(means, quats, looks.log_scales[ids], logits, looks.sh0[ids], looks.sh_rest[ids]))


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
