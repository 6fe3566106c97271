"""Tile codecs by name: how a player turns a bundle's payloads into splats.

``svq`` is this project's own. The seam exists for the codecs that it is compared with (:mod:`cags_research.codecs`);
they share bundles, sessions, rate policies and the client, and differ here alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from copy import copy
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np

from cags_common.errors import BundleError, ConfigError, DecodeError
from cags_common.geometry import F32
from cags_common.motion.apply import Steps
from cags_common.motion.chunk import LEVELS as MOTION_LEVELS
from cags_common.motion.chunk import VERSION as MOTION_VERSION
from cags_common.motion.chunk import Chunk, ChunkDecoder
from cags_common.motion.neighbours import Anchors
from cags_common.registry import Registry
from cags_common.splats import Ids, Splats
from cags_common.tiles.dequantise import Dequantiser
from cags_common.tiles.kinds import TileKind
from cags_common.tiles.lod import check_order, depths_at
from cags_common.tiles.payloads import decode_base, decode_base_ids
from cags_common.tiles.state import TileState
from cags_common.tiles.svq import CodebookSet
from cags_common.tiles.updates import UPDATE_VERSION, Change, UpdateState, update_ids

if TYPE_CHECKING:  # the bundle's reader opens tiles by this module
    from cags_common.bundle.manifest import Manifest


Run: TypeAlias = Callable[..., Iterable[Any]]
"""``map`` or an executor's."""


class TileDecoder(Protocol):
    """One tile of looks as far as it has come. Not thread-safe."""

    @property
    def kind(self) -> TileKind:
        """What the tile brings: ``TileKind.LOOKS``."""
        ...

    @property
    def steps(self) -> Steps | None:
        """Units of the splats' motion; None in bundles without any."""
        ...

    def __len__(self) -> int: ...

    @property
    def ids(self) -> Ids:
        """Ids [n] of the splats there are, ascending. A later level may bring more."""
        ...

    @property
    def means(self) -> F32:
        """Their positions [n, 3] as LoD 0 tells them, by which motion is told; world, metres."""
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

    @property
    def grows(self) -> bool:
        """Whether a further level may bring more splats."""
        ...

    def fork(self) -> TileDecoder:
        """Another decoder of what has come; what is added to one of the two does not change the other."""
        ...

    def reduced(self, lods: int) -> TileDecoder:
        """Another decoder, of LoDs 0 .. ``lods`` - 1 alone, which have come; of a whole tile, of what is there."""
        ...

    def dequantise(self, into: Splats | None = None) -> Splats:
        """The splats [n] in the order of :attr:`ids`; in the arrays of ``into`` [n] where it is given."""
        ...


def anchors_of(looks: TileDecoder) -> Anchors | None:
    """What motion of ``looks`` is told by; None in bundles without motion."""
    steps = looks.steps
    return None if steps is None else Anchors(looks.means, steps.moves, steps.turns)


class MotionTile:
    """A chunk of motion as far as it has come; levels may come in any order. Not thread-safe."""

    kind = TileKind.MOTION

    def __init__(self, payload: bytes | memoryview, anchors: Anchors) -> None:
        """Decode level 0; ``anchors`` are the looks that move. Raises :class:`DecodeError`."""
        self._decoder = ChunkDecoder(payload, anchors)
        self._waiting: dict[int, bytes] = {}

    def __len__(self) -> int:
        return self._decoder.splats

    @property
    def looks(self) -> tuple[int, int]:
        """Media frame and tile of the looks that move."""
        return self._decoder.looks

    @property
    def chunk(self) -> Chunk:
        """The motion, at the levels there are."""
        return self._decoder.chunk

    @property
    def lod(self) -> int:
        """Highest level up to which everything has come."""
        return self._decoder.levels - 1

    @property
    def nbytes(self) -> int:
        """What is kept for further levels, besides the chunk."""
        return self._decoder.nbytes + sum(map(len, self._waiting.values()))

    def add_layer(self, lod: int, payload: bytes | memoryview) -> bool:
        """Take level ``lod`` >= 1; whether the motion changed. Raises :class:`DecodeError`."""
        if not 1 <= lod < MOTION_LEVELS:
            raise DecodeError(f"motion: level {lod} is outside 1 to {MOTION_LEVELS - 1}")
        if lod < self._decoder.levels:
            return False
        self._waiting[lod] = bytes(payload)
        before = self._decoder.levels
        while (level := self._waiting.pop(self._decoder.levels, None)) is not None:
            self._decoder.add_level(level)
        return self._decoder.levels > before

    def fork(self) -> MotionTile:
        """Another tile of what has come; what is added to one of the two does not change the other."""
        other = copy(self)
        other._decoder, other._waiting = self._decoder.fork(), dict(self._waiting)
        return other


class MotionDecoder(Protocol):
    """A chunk of motion as far as it has come. Not thread-safe."""

    def __len__(self) -> int: ...

    @property
    def looks(self) -> tuple[int, int]:
        """Media frame and tile of the looks that move."""
        ...

    @property
    def chunk(self) -> Chunk:
        """The motion, at the levels there are; :meth:`add_layer` changes it in place."""
        ...

    @property
    def lod(self) -> int:
        """Highest level up to which everything has come."""
        ...

    def add_layer(self, lod: int, payload: bytes | memoryview) -> bool:
        """Take level ``lod`` >= 1; whether the motion changed. Raises :class:`DecodeError`."""
        ...

    def fork(self) -> MotionDecoder:
        """Another decoder of what has come; what is added to one of the two does not change the other."""
        ...


class UpdateDecoder(Protocol):
    """An update as far as it has come. Not thread-safe."""

    def __len__(self) -> int: ...

    @property
    def ids(self) -> Ids:
        """Ids [n] of the splats of which anything changes, ascending."""
        ...

    @property
    def lod(self) -> int:
        """Highest LoD up to which everything has come."""
        ...

    def add_layer(self, lod: int, payload: bytes | memoryview) -> bool:
        """Take LoD ``lod`` >= 1; whether :meth:`values` changed. Raises :class:`DecodeError`."""
        ...

    def values(self) -> dict[str, Change]:
        """Column of :class:`Splats` -> change, at the depths there are."""
        ...

    def fork(self) -> UpdateDecoder:
        """Another decoder of what has come; what is added to one of the two does not change the other."""
        ...

    def reduced(self, lods: int) -> UpdateDecoder:
        """Another decoder, of LoDs 0 .. ``lods`` - 1 alone, all of which have come."""
        ...


AnyTile: TypeAlias = "TileDecoder | MotionTile | UpdateState"


class TileCodec(Protocol):
    """Opens the tiles of one bundle."""

    def open_tile(self, payload: bytes | memoryview, anchors: Anchors | None = None) -> AnyTile:
        """Decode LoD 0 of a tile of any kind; motion needs ``anchors``, the looks that it moves.

        Raises :class:`DecodeError`.
        """
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
        """``codebooks`` may hold base layers only; :meth:`extend` adds the others, before any level above 0 is added.

        Raises :class:`BundleError` for a manifest that does not fit them, :class:`DecodeError` where they cannot be
        read.
        """
        self._books, self._order = CodebookSet.from_bytes(codebooks), manifest.lod_order
        if self._books.sh_degree != manifest.sh_degree:
            raise BundleError(
                f"manifest: sh_degree is {manifest.sh_degree}, but the codebooks are of degree {self._books.sh_degree}"
            )
        self._check(self._books, begun=True)
        self._dequantiser = Dequantiser(self._books)
        self._steps = _step_tables(manifest, self._books)

    def base_codebooks(self) -> bytes:
        """Serialised codebooks of base layers alone."""
        return self._books.base.to_bytes()

    def extend(self, codebooks: bytes | memoryview) -> None:
        """Add the layers above the base; open tiles take further levels from now on. Raises :class:`DecodeError`."""
        books = CodebookSet.from_bytes(codebooks)
        self._check(books, begun=False)
        self._dequantiser.extend(books)

    def _check(self, books: CodebookSet, *, begun: bool) -> None:
        layers = {book.attribute: book.enhancement_layers for book in books}
        if begun and not any(layers.values()):
            layers |= depths_at([item for item in self._order if item.attribute in layers], len(self._order))
        check_order(self._order, layers)

    def open_tile(self, payload: bytes | memoryview, anchors: Anchors | None = None) -> AnyTile:
        """Decode LoD 0; its first byte tells the kinds apart."""
        version = payload[0] if len(payload) else 0
        if version == UPDATE_VERSION:
            return UpdateState(payload, self._books, self._order)
        if version == MOTION_VERSION:
            if anchors is None:
                raise DecodeError("motion: cannot be read without the looks that it moves")
            return MotionTile(payload, anchors)
        return TileState(decode_base(payload, self._books), self._dequantiser, self._order, self._steps)

    def tile_ids(self, payload: bytes | memoryview) -> Ids:
        """Only the ids [n] of a LoD 0 payload of looks or of an update."""
        if len(payload) and payload[0] == UPDATE_VERSION:
            return update_ids(payload)
        return decode_base_ids(payload)


def _step_tables(manifest: Manifest, books: CodebookSet) -> Steps | None:
    """Units of motion by the base code of scale."""
    motion = manifest.motion
    if motion is None:
        return None
    if "scale" not in books.attributes or len(motion.moves) != 1 << books["scale"].layer_bits[0]:
        raise BundleError(f"manifest: motion has {len(motion.moves)} units, which are not one a base code of scale")
    return Steps(np.array(motion.moves, np.float32), np.array(motion.turns, np.float32))


TILE_CODECS: Registry[Callable[[Manifest, bytes | memoryview], TileCodec]] = Registry(
    "codec", "cags.tile_codecs", {"svq": SvqTileCodec}
)
"""Tile codecs by the name that a manifest gives."""

WHOLE_TILES_CODEC = "video"
"""Codec of bundles whose LoD k is the whole tile at quality k: any payload opens a tile."""


def tile_codec(manifest: Manifest, codebooks: bytes | memoryview) -> TileCodec:
    """The codec that ``manifest`` names, with a bundle's serialised codebooks.

    Raises :class:`BundleError` for an unknown codec and :class:`DecodeError` for codebooks that it does not read.
    """
    try:
        opener = TILE_CODECS.find(manifest.codec)
    except ConfigError as error:
        raise BundleError(f"bundle of another codec: {error}") from error
    return opener(manifest, codebooks)
