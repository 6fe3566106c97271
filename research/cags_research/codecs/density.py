"""The density codec of the ``lts-f`` baseline: a level of detail is a number of splats.

As published (LTS, Sun et al., MMSys 2025): levels are nested subsets, each level adds splats and is coded on its own by
Draco, and the levels of a tile are sent in order. Standing in: LTS trains its layers one on the other, so that each
subset is optimised to look right alone; here subsets are picked from a given scene by importance, and the splats of an
incomplete subset are grown, by an amount that the encoder chooses for every level. (Making them more opaque as well was
tried and looks worse.)
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle.manifest import Manifest
from cags_common.coding.packing import U32, decode_ids, encode_ids
from cags_common.errors import DecodeError
from cags_common.geometry import F32
from cags_common.motion.apply import Steps
from cags_common.motion.neighbours import Anchors
from cags_common.splats import Ids, Splats
from cags_common.tiles.attributes import join_attributes
from cags_common.tiles.kinds import TileKind
from cags_research.codecs.cloud import TileHead, decode_cloud, decode_head, encode_cloud
from cags_research.codecs.scalar import U8, ScalarBook

KIND = b"DENS"
MAX_LEVELS = 32
MAX_LOG_GAIN = 2.0

_LEVELS = struct.Struct("<B")
_GAIN = struct.Struct("<f")
_CHUNK = struct.Struct("<II")  # splats, bytes of their row list


@dataclass(frozen=True, eq=False)
class DensityLevels:
    """Which splats of a tile come with which level."""

    rows: Sequence[NDArray[np.intp]]  # for each level the ascending rows that it adds, all rows once
    log_gains: Sequence[float]
    """For each level, added to the logarithms of all standard deviations while it is the highest."""


def encode_density(head: bytes, columns: Sequence[U8], cells: U32, bits: int, levels: DensityLevels) -> list[bytes]:
    """One payload a level, from attributes [n, dim] and grid coordinates [n, 3] of ``bits`` bits.

    ``head`` is of :func:`~cags_research.codecs.cloud.encode_head` for :data:`KIND`.
    """
    chunks = []
    for rows in levels.rows:
        listed = encode_ids(rows.astype(np.int32))
        cloud = encode_cloud(cells[rows], [column[rows] for column in columns], bits) if len(rows) else b""
        chunks.append(_CHUNK.pack(len(rows), len(listed)) + listed + cloud)
    gains = b"".join(map(_GAIN.pack, levels.log_gains))
    return [head + _LEVELS.pack(len(levels.rows)) + gains + chunks[0], *chunks[1:]]


@dataclass(frozen=True, eq=False)
class _Chunk:
    """The splats that one level adds."""

    rows: Ids  # [m] ascending rows of the tile
    cells: F32  # [m, 3]
    columns: list[U8]  # attribute by attribute [m, dim]


class DensityTile:
    """A tile of which the most important splats are there. Levels may come in any order and show without gaps."""

    kind = TileKind.LOOKS
    steps: Steps | None = None

    def __init__(self, payload: bytes | memoryview, book: ScalarBook) -> None:
        self._book = book
        self._head, self._gains, start = _open(payload)
        self._chunks = {0: _decode_chunk(memoryview(payload)[start:], self._head, book)}
        self._lod = 0
        self._merge()

    @property
    def lod(self) -> int:
        """Highest level up to which everything has come."""
        return self._lod

    @property
    def ids(self) -> Ids:
        """Ids [m] of the splats that are there, ascending."""
        shown: Ids = self._head.ids[self._rows]
        return shown

    @property
    def means(self) -> F32:
        """Their positions [m, 3], world, metres."""
        return self._head.grid.dequantise(self._cells)

    def __len__(self) -> int:
        return len(self._rows)

    def add_layer(self, lod: int, payload: bytes | memoryview) -> bool:
        """Take level ``lod`` >= 1. Returns whether more splats show now. Raises :class:`DecodeError`."""
        if not 1 <= lod < len(self._gains):
            raise DecodeError(f"tile: level {lod} is outside 1 to {len(self._gains) - 1}")
        if lod in self._chunks:
            return False
        self._chunks[lod] = _decode_chunk(payload, self._head, self._book)
        before = self._lod
        while self._lod + 1 in self._chunks:
            self._lod += 1
        if self._lod > before:
            self._merge()
        return self._lod > before

    @property
    def grows(self) -> bool:
        """Whether a further level may bring more splats."""
        return self._lod + 1 < len(self._gains)

    def fork(self) -> DensityTile:
        """Another tile of what has come; what is added to one of the two does not change the other."""
        other = copy(self)
        other._chunks = dict(self._chunks)
        return other

    def reduced(self, lods: int) -> DensityTile:
        """Another tile, of levels 0 .. ``lods`` - 1 alone, all of which have come."""
        other = copy(self)
        other._chunks, other._lod = {level: self._chunks[level] for level in range(lods)}, lods - 1
        other._merge()
        return other

    def dequantise(self, into: Splats | None = None) -> Splats:
        """The splats that are there, [m], compensated for those that are not."""
        values = {
            name: self._book.dequantise(name, codes) for name, codes in zip(self._book, self._columns, strict=True)
        }
        values["scale"] += np.float32(self._gains[self._lod])
        return join_attributes(self.means, values).written_to(into)

    def _merge(self) -> None:
        parts = [self._chunks[k] for k in range(self._lod + 1)]
        rows = np.concatenate([part.rows for part in parts])
        order = np.argsort(rows, kind="stable")
        self._rows = rows[order]
        if (np.diff(self._rows) == 0).any():
            raise DecodeError("tile: two levels hold the same splat")
        self._cells = np.concatenate([part.cells for part in parts])[order]
        self._columns = [np.concatenate(columns)[order] for columns in zip(*(p.columns for p in parts), strict=True)]


def _open(payload: bytes | memoryview) -> tuple[TileHead, list[float], int]:
    head = decode_head(payload, KIND)
    view = memoryview(payload)[head.size :]
    levels = view[0] if len(view) else 0
    if not 1 <= levels <= MAX_LEVELS or len(view) < _LEVELS.size + levels * _GAIN.size:
        raise DecodeError(f"tile: claims {levels} levels; 1 to {MAX_LEVELS} are allowed")
    gains = [float(_GAIN.unpack_from(view, _LEVELS.size + k * _GAIN.size)[0]) for k in range(levels)]
    if not all(abs(gain) <= MAX_LOG_GAIN for gain in gains):
        raise DecodeError(f"tile: compensation {gains} is beyond {MAX_LOG_GAIN}")
    return head, gains, head.size + _LEVELS.size + levels * _GAIN.size


def _decode_chunk(payload: bytes | memoryview, head: TileHead, book: ScalarBook) -> _Chunk:
    view = memoryview(payload)
    if len(view) < _CHUNK.size:
        raise DecodeError("tile: a level is cut short")
    count, listed = _CHUNK.unpack_from(view)
    if count > len(head.ids) or listed > len(view) - _CHUNK.size:
        raise DecodeError(f"tile: a level claims {count} of {len(head.ids)} splats")
    rows = decode_ids(view[_CHUNK.size : _CHUNK.size + listed], what="tile: rows of a level", limit=len(head.ids))
    if len(rows) != count:
        raise DecodeError(f"tile: a level has {len(rows)} rows for {count} splats")
    if count == 0:
        return _Chunk(rows, np.zeros((0, 3), np.float32), [np.zeros((0, dim), np.uint8) for dim in book.dims])
    return _Chunk(rows, *decode_cloud(bytes(view[_CHUNK.size + listed :]), count, book.dims))


class DensityTileCodec:
    """Opens tiles of the density codec (:class:`cags_common.bundle.codecs.TileCodec`)."""

    def __init__(self, manifest: Manifest, codebooks: bytes | memoryview) -> None:
        del manifest  # every tile says how many levels it has
        self._book = ScalarBook.from_bytes(codebooks)

    def open_tile(self, payload: bytes | memoryview, anchors: Anchors | None = None) -> DensityTile:
        """Decode the first level. Raises :class:`DecodeError`."""
        del anchors  # splats that move are sent anew
        return DensityTile(payload, self._book)

    def tile_ids(self, payload: bytes | memoryview) -> Ids:
        """Ids [n] of all splats of a tile, whatever level they come with, from its first payload."""
        return decode_head(payload, KIND).ids
