"""The video codec of the ``v3-a`` baseline: attributes as planes of pictures, coded by H.264 at several qualities.

As published (V3, Wang et al., SIGGRAPH Asia 2024): splats in Morton order become pixels, every number of an attribute
a plane of bytes, and a video codec compresses the planes; there are no layers, so that a better quality is sent whole.
Standing in: V3 trains its splats under an entropy loss and codes planes as videos over a group of frames; here the
splats are given and every tile's picture is intra-coded, since tiles hold whatever splats have changed and are decoded
on their own. Positions, of which V3 codes a high and a low byte without loss, go through Draco as everywhere here.
"""

from __future__ import annotations

import struct
from copy import copy

import numpy as np

from cags_common.bundle.manifest import Manifest
from cags_common.coding.packing import U32
from cags_common.errors import DecodeError
from cags_common.geometry import F32
from cags_common.motion.apply import Steps
from cags_common.motion.neighbours import Anchors
from cags_common.splats import Ids, Splats
from cags_common.tiles.attributes import join_attributes
from cags_common.tiles.kinds import TileKind
from cags_research.codecs.cloud import decode_cloud, decode_head, encode_cloud
from cags_research.codecs.planes import decode_planes, encode_planes
from cags_research.codecs.scalar import U8, ScalarBook

KIND = b"VIDE"
_PARTS = struct.Struct("<BI")  # quality, bytes of the positions


def encode_video(head: bytes, codes: U8, cells: U32, bits: int, crfs: tuple[int, ...]) -> list[bytes]:
    """One payload a quality, each of them the whole tile: ``codes`` [n, numbers a splat], grid coordinates [n, 3].

    ``head`` is of :func:`~cags_research.codecs.cloud.encode_head` for :data:`KIND`.
    """
    cloud = encode_cloud(cells, [], bits)
    pictures = [encode_planes(codes, crf) for crf in crfs]
    return [head + _PARTS.pack(k, len(cloud)) + cloud + picture for k, picture in enumerate(pictures)]


class VideoTile:
    """A tile at one quality. Any payload opens it; a better one replaces it."""

    kind = TileKind.LOOKS
    steps: Steps | None = None

    def __init__(self, payload: bytes | memoryview, book: ScalarBook) -> None:
        self._book = book
        self._lod = 0
        self._take(payload)

    @property
    def lod(self) -> int:
        """The quality that is there."""
        return self._lod

    @property
    def ids(self) -> Ids:
        """Ids [n], ascending."""
        return self._head.ids

    @property
    def means(self) -> F32:
        """Their positions [n, 3], world, metres."""
        return self._head.grid.dequantise(self._cells)

    def __len__(self) -> int:
        return len(self._head.ids)

    def add_layer(self, lod: int, payload: bytes | memoryview) -> bool:
        """Take the tile at quality ``lod``. Returns whether it was better. Raises :class:`DecodeError`."""
        if lod <= self._lod:
            return False
        held = self._head.ids
        self._take(payload)
        if self._lod != lod or not np.array_equal(held, self._head.ids):
            raise DecodeError(f"tile: quality {self._lod} is of another tile, or was sent as {lod}")
        return True

    @property
    def grows(self) -> bool:
        """Whether a further quality may bring more splats: never."""
        return False

    def fork(self) -> VideoTile:
        """Another tile of what has come; what is added to one of the two does not change the other."""
        return copy(self)

    def reduced(self, lods: int) -> VideoTile:
        """Another tile of what has come: nothing is left of the qualities below it."""
        del lods
        return copy(self)

    def dequantise(self, into: Splats | None = None) -> Splats:
        """The tile's splats [n]."""
        ends = np.cumsum(self._book.dims)
        parts = zip(self._book, np.split(self._codes, ends[:-1], axis=1), strict=True)
        values = {name: self._book.dequantise(name, codes) for name, codes in parts}
        return join_attributes(self.means, values).written_to(into)

    def _take(self, payload: bytes | memoryview) -> None:
        head = decode_head(payload, KIND)
        view = memoryview(payload)[head.size :]
        if len(view) < _PARTS.size:
            raise DecodeError("tile: is cut short")
        lod, size = (int(field) for field in _PARTS.unpack_from(view))
        if size > len(view) - _PARTS.size:
            raise DecodeError(f"tile: claims {size} bytes of positions, {len(view) - _PARTS.size} are there")
        body = view[_PARTS.size :]
        cells, _ = decode_cloud(bytes(body[:size]), len(head.ids), ())
        codes = decode_planes(bytes(body[size:]), len(head.ids), sum(self._book.dims))
        self._head, self._lod, self._cells, self._codes = head, lod, cells, codes


class VideoTileCodec:
    """Opens tiles of the video codec (:class:`cags_common.bundle.codecs.TileCodec`)."""

    def __init__(self, manifest: Manifest, codebooks: bytes | memoryview) -> None:
        del manifest  # every payload says which quality it is
        self._book = ScalarBook.from_bytes(codebooks)

    def open_tile(self, payload: bytes | memoryview, anchors: Anchors | None = None) -> VideoTile:
        """Decode a tile at any quality. Raises :class:`DecodeError`."""
        del anchors  # splats that move are sent anew
        return VideoTile(payload, self._book)

    def tile_ids(self, payload: bytes | memoryview) -> Ids:
        """Ids [n] of a tile, from its payload at any quality."""
        return decode_head(payload, KIND).ids
