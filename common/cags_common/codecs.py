"""Tile codecs by name: how a player turns a bundle's payloads into splats.

``svq`` is this project's own. The seam exists for the baselines that it is compared with; they share bundles, sessions,
rate policies and the client, and differ here alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from cags_common.dequantise import Dequantiser
from cags_common.errors import BundleError
from cags_common.geometry import F32
from cags_common.lod import check_order
from cags_common.splats import Ids, Splats
from cags_common.svq import CodebookSet
from cags_common.tile_state import TileState
from cags_common.tiles import decode_base, decode_base_ids

if TYPE_CHECKING:  # the bundle's reader opens tiles by this module
    from cags_common.bundle.manifest import Manifest


Run: TypeAlias = Callable[..., Iterable[Any]]
"""``map`` or an executor's."""


class TileDecoder(Protocol):
    """One tile as far as it has come. Not thread-safe."""

    def __len__(self) -> int: ...

    @property
    def ids(self) -> Ids:
        """Ids [n] of the splats there are, ascending. A later level may bring more."""
        ...

    @property
    def means(self) -> F32:
        """Their positions [n, 3], world, metres."""
        ...

    @property
    def lod(self) -> int:
        """Highest LoD up to which everything has come."""
        ...

    def add_layer(self, lod: int, payload: bytes | memoryview) -> bool:
        """Take the payload of LoD ``lod`` >= 1.

        Returns whether :meth:`dequantise` changed. Raises :class:`DecodeError`.
        """
        ...

    def dequantise(self, into: Splats | None = None) -> Splats:
        """The splats [n] in the order of :attr:`ids`; in the arrays of ``into`` [n] where it is given."""
        ...


class TileCodec(Protocol):
    """Opens the tiles of one bundle."""

    def open_tile(self, payload: bytes | memoryview) -> TileDecoder:
        """Decode LoD 0. Raises :class:`DecodeError`."""
        ...

    def tile_ids(self, payload: bytes | memoryview) -> Ids:
        """Only the ids [n] of a LoD 0 payload. Raises :class:`DecodeError`."""
        ...


def dequantise_tiles(tiles: Sequence[TileDecoder], sh_degree: int, run: Run = map) -> Splats:
    """All splats of different ``tiles`` in order, each tile written straight to its place; ``run`` may use threads."""
    ends = list(accumulate(map(len, tiles), initial=0))
    out = Splats.unwritten(ends[-1], sh_degree)
    places = [out.span(first, end) for first, end in pairwise(ends)]
    for _ in run(lambda tile, place: tile.dequantise(place), tiles, places):
        pass
    return out


class SvqTileCodec:
    """Draco base layers and enhancement layers of Scalable Vector Quantisation."""

    def __init__(self, manifest: Manifest, codebooks: bytes | memoryview) -> None:
        self._books, self._order = CodebookSet.from_bytes(codebooks), manifest.lod_order
        check_order(self._order, {book.attribute: book.enhancement_layers for book in self._books})
        self._dequantiser = Dequantiser(self._books)

    def open_tile(self, payload: bytes | memoryview) -> TileDecoder:
        """Decode LoD 0."""
        return TileState(decode_base(payload, self._books), self._dequantiser, self._order)

    def tile_ids(self, payload: bytes | memoryview) -> Ids:
        """Only the ids [n] of a LoD 0 payload."""
        return decode_base_ids(payload)


def _density(manifest: Manifest, codebooks: bytes | memoryview) -> TileCodec:
    from cags_common.baselines.density import DensityTileCodec

    return DensityTileCodec(manifest, codebooks)


def _video(manifest: Manifest, codebooks: bytes | memoryview) -> TileCodec:
    from cags_common.baselines.video import VideoTileCodec

    return VideoTileCodec(manifest, codebooks)


TILE_CODECS: dict[str, Callable[[Manifest, bytes | memoryview], TileCodec]] = {
    "svq": SvqTileCodec,
    "density": _density,
    "video": _video,
}


WHOLE_TILES_CODEC = "video"
"""Codec of bundles whose LoD k is the whole tile at quality k: any payload opens a tile."""


def tile_codec(manifest: Manifest, codebooks: bytes | memoryview) -> TileCodec:
    """The codec that ``manifest`` names, with a bundle's serialised codebooks.

    Raises :class:`BundleError` for an unknown codec and :class:`DecodeError` for codebooks that it does not read.
    """
    if manifest.codec not in TILE_CODECS:
        raise BundleError(f"codec {manifest.codec!r} is unknown; this program reads: {', '.join(TILE_CODECS)}")
    return TILE_CODECS[manifest.codec](manifest, codebooks)
