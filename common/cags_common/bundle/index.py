"""The indices at the end of a group's files: what each frame and tile holds, how large each payload is, and its CRC-32.

Payloads lie in order without gaps, so sizes give offsets. Layout: ``docs/bundle.md``.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cags_common.coding.packing import gunzip_bounded, gzip_bytes
from cags_common.errors import BundleError, DecodeError
from cags_common.geometry import Vec3
from cags_common.motion.chunk import LEVELS, MAX_SPAN
from cags_common.splats import MAX_SPLATS
from cags_common.tiles.kinds import TileKind
from cags_common.tiles.payloads import MAX_TILE_SPLATS

TILES_MAGIC = b"CAGSGF02"
SOURCE_MAGIC = b"CAGSSR01"
MAX_INDEX_BYTES = 512 * 2**20

_HEADER = struct.Struct("<IIII")
_FRAME = np.dtype([("tiles", "<u4"), ("removed_count", "<u4"), ("removed_bytes", "<u4"), ("removed_crc", "<u4")])
_TILE = np.dtype(
    [
        *(("kind", "u1"), ("span", "u1"), ("looks_tile", "<u4"), ("looks_frame", "<u4")),
        *(("splats", "<u4"), ("first_id", "<i4"), ("low", "<f4", 3), ("high", "<f4", 3)),
    ]
)
_SOURCE = np.dtype([("bytes", "<u8"), ("head_bytes", "<u4"), ("head_crc", "<u4")])


@dataclass(frozen=True)
class TileEntry:
    """One tile of one frame."""

    tile: int
    splats: int
    first_id: int | None
    """First id of a key-frame tile, whose ids are consecutive; None for later frames, whose payloads carry ids."""
    bounds: tuple[Vec3, Vec3]
    """Smallest and largest corner of the tile's means (without the splats' own extent), world, metres."""
    lod_bytes: tuple[int, ...]
    """Size of each level that the tile has; those of motion have levels of their own."""
    crcs: tuple[int, ...]
    kind: TileKind = TileKind.LOOKS
    looks: tuple[int, int] | None = None
    """Media frame and tile of the looks that a tile of motion moves; None for other kinds."""
    span: int = 0
    """Frames that a tile of motion covers after its first."""


@dataclass(frozen=True, slots=True)
class FrameEntry:
    """One frame: its tiles and how many ids it removes."""

    frame: int
    keyframe: bool
    gof: int
    tiles: tuple[TileEntry, ...]
    removed_count: int
    removed_bytes: int
    removed_crc: int
    offset: int
    """Where the frame's payloads begin in its group's file: the removed ids first, then tile by tile, LoD by LoD."""

    @property
    def size_bytes(self) -> int:
        """All payloads of the frame."""
        return self.removed_bytes + sum(sum(tile.lod_bytes) for tile in self.tiles)


def encode_tile_index(frames: Sequence[FrameEntry], lods: int) -> bytes:
    """Pack the entries of one group of frames."""
    tiles = [tile for frame in frames for tile in frame.tiles]
    frame_rows = np.array([(len(f.tiles), f.removed_count, f.removed_bytes, f.removed_crc) for f in frames], _FRAME)
    tile_rows = np.array([_tile_row(tile) for tile in tiles], _TILE)
    columns = _columns(lods)
    sizes = np.array([_padded(t.lod_bytes, columns) for t in tiles], "<u4").reshape(-1, columns)
    crcs = np.array([_padded(t.crcs, columns) for t in tiles], "<u4").reshape(-1, columns)
    head = _HEADER.pack(frames[0].frame, len(frames), lods, len(tiles))
    return gzip_bytes(b"".join([head, *(rows.tobytes() for rows in (frame_rows, tile_rows, sizes, crcs))]))


def _tile_row(tile: TileEntry) -> tuple[object, ...]:
    frame, number = tile.looks or (0, 0)
    first_id = -1 if tile.first_id is None else tile.first_id
    return (int(tile.kind), tile.span, number, frame, tile.splats, first_id, *tile.bounds)


def _columns(lods: int) -> int:
    """Sizes and checksums of a tile: motion may have more levels than looks have LoDs."""
    return max(lods, LEVELS)


def _padded(values: tuple[int, ...], columns: int) -> tuple[int, ...]:
    return (*values, *(0,) * (columns - len(values)))


def decode_tile_index(data: bytes, *, gof: int, frames: range, lods: int) -> tuple[FrameEntry, ...]:
    """Inverse of :func:`encode_tile_index` for the group ``gof`` of ``frames``. Raises :class:`BundleError`."""
    raw = _unpacked(data, f"index of group {gof}")
    if len(raw) < _HEADER.size:
        raise BundleError(f"index of group {gof}: is cut short")
    first, count, found_lods, tiles = _HEADER.unpack_from(raw)
    if (first, count, found_lods) != (frames.start, len(frames), lods):
        raise BundleError(
            f"index of group {gof}: is for {count} frames from {first} with {found_lods} LoDs, not this group"
        )
    columns = _columns(lods)
    expected = _HEADER.size + count * _FRAME.itemsize + tiles * (_TILE.itemsize + 8 * columns)
    if len(raw) != expected:
        raise BundleError(f"index of group {gof}: has {len(raw)} bytes, expected {expected}")
    at = _HEADER.size
    frame_rows = np.frombuffer(raw, _FRAME, count, at)
    at += frame_rows.nbytes
    tile_rows = np.frombuffer(raw, _TILE, tiles, at)
    at += tile_rows.nbytes
    sizes = np.frombuffer(raw, "<u4", tiles * columns, at).reshape(tiles, columns)
    crcs = np.frombuffer(raw, "<u4", tiles * columns, at + sizes.nbytes).reshape(tiles, columns)
    if int(frame_rows["tiles"].sum()) != tiles or (tiles and int(tile_rows["splats"].max()) > MAX_TILE_SPLATS):
        raise BundleError(f"index of group {gof}: tile counts do not add up or exceed {MAX_TILE_SPLATS} splats a tile")
    return _frame_entries(gof, first, frame_rows, (tile_rows, sizes, crcs), lods)


class SourceEntry(NamedTuple):
    """Where a source frame is within the file of its group."""

    size_bytes: int
    head_bytes: int
    head_crc: int


def encode_source_index(entries: Sequence[SourceEntry]) -> bytes:
    """Pack the entries of a group's source frames."""
    return gzip_bytes(np.array(list(entries), _SOURCE).tobytes())


def decode_source_index(data: bytes, *, gof: int, frames: int) -> tuple[SourceEntry, ...]:
    """Inverse of :func:`encode_source_index`. Raises :class:`BundleError`."""
    raw = _unpacked(data, f"source index of group {gof}")
    if len(raw) != frames * _SOURCE.itemsize:
        raise BundleError(f"source index of group {gof}: has {len(raw)} bytes, expected {frames * _SOURCE.itemsize}")
    entries = tuple(SourceEntry(*map(int, row)) for row in np.frombuffer(raw, _SOURCE))
    if any(entry.head_bytes > entry.size_bytes for entry in entries):
        raise BundleError(f"source index of group {gof}: claims a frame that begins with more bytes than it has")
    return entries


def _unpacked(data: bytes, what: str) -> bytes:
    try:
        return gunzip_bounded(data, MAX_INDEX_BYTES, what)
    except DecodeError as error:
        raise BundleError(str(error)) from error


def _frame_entries(
    gof: int, first: int, frame_rows: np.ndarray, of_tiles: tuple[np.ndarray, np.ndarray, np.ndarray], lods: int
) -> tuple[FrameEntry, ...]:
    tile_rows, sizes, crcs = of_tiles
    out, offset, row = [], len(TILES_MAGIC), 0
    for index, f in enumerate(frame_rows):
        count = int(f["tiles"])
        tiles = tuple(
            _tile_entry(tile, tile_rows[row + tile], sizes[row + tile], crcs[row + tile], lods) for tile in range(count)
        )
        removed = int(f["removed_count"]), int(f["removed_bytes"]), int(f["removed_crc"])
        entry = FrameEntry(first + index, index == 0, gof, tiles, *removed, offset)
        out.append(entry)
        offset, row = offset + entry.size_bytes, row + count
    return tuple(out)


def _tile_entry(tile: int, row: np.void, sizes: np.ndarray, crcs: np.ndarray, lods: int) -> TileEntry:
    first, kind, span = int(row["first_id"]), int(row["kind"]), int(row["span"])
    if first >= MAX_SPLATS or kind >= len(TileKind) or span > MAX_SPAN or (kind == TileKind.MOTION) != (span > 0):
        raise BundleError(f"index: first id {first}, kind {kind}, span {span} of tile {tile} are outside the bounds")
    levels = LEVELS if kind == TileKind.MOTION else lods
    low, high = row["low"].tolist(), row["high"].tolist()
    bounds = (low[0], low[1], low[2]), (high[0], high[1], high[2])
    return TileEntry(
        tile,
        int(row["splats"]),
        None if first < 0 else first,
        bounds,
        tuple(sizes[:levels].tolist()),
        tuple(crcs[:levels].tolist()),
        TileKind(kind),
        (int(row["looks_frame"]), int(row["looks_tile"])) if kind == TileKind.MOTION else None,
        span,
    )
