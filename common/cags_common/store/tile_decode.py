"""Parallel decoding of tiles: Draco and the kernels release the GIL, so threads help."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Protocol, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle.codecs import (
    AnyTile,
    MotionDecoder,
    MotionTile,
    TileCodec,
    TileDecoder,
    UpdateDecoder,
    anchors_of,
    dequantise_tiles,
)
from cags_common.errors import DecodeError
from cags_common.geometry import F32, Camera, axis_bounds
from cags_common.motion.chunk import VERSION as MOTION_VERSION
from cags_common.motion.chunk import read_looks
from cags_common.splats import Splats
from cags_common.tiles.updates import UpdateState

T = TypeVar("T")
U = TypeVar("U")


Key: TypeAlias = tuple[int, int]
"""Media frame and tile."""


@dataclass(frozen=True, slots=True)
class Arrival:
    """Layers of one tile in a message: ``payloads[i]`` is LoD ``from_lod + i``."""

    frame: int
    tile: int
    from_lod: int
    payloads: list[memoryview]

    @property
    def key(self) -> Key:
        """Source frame and tile."""
        return self.frame, self.tile


@dataclass(frozen=True, slots=True)
class First:
    """A payload that opens a tile: LoD 0, or any LoD if every payload is a whole tile."""

    key: Key
    lod: int
    payload: memoryview
    looks: TileDecoder | None = None
    """What a tile of motion moves."""


@dataclass(frozen=True, eq=False)
class Sphere:
    """Bounding sphere of a tile's means."""

    centre: F32  # [3] world, metres
    radius: float


@dataclass(frozen=True, eq=False)
class OpenTile:
    """A decoded base layer of looks with its bounding sphere."""

    state: TileDecoder
    sphere: Sphere


@dataclass(frozen=True, eq=False)
class OpenMotion:
    """A decoded first level of motion."""

    state: MotionDecoder


@dataclass(frozen=True, eq=False)
class OpenUpdate:
    """A decoded base layer of an update."""

    state: UpdateDecoder


Opened: TypeAlias = OpenTile | OpenMotion | OpenUpdate
"""A tile of any kind with decoded LoD 0."""


class Opener(Protocol):
    """Creates decoders for the tiles of a store."""

    bounded: bool
    """Whether the memory of decoders counts towards the limit on tiles kept for replays."""

    @property
    def threads(self) -> int:
        """Number of decoding threads, which does not affect results."""
        ...

    def opened(self, firsts: Sequence[First]) -> list[Opened | DecodeError]:
        """A decoder for each tile, or why it cannot be read."""
        ...

    def looks_of(self, first: First) -> Key | None:
        """The looks that a tile of motion moves; None of other kinds, and where that cannot be read."""
        ...

    def kept(self, payload: memoryview) -> bytes | memoryview:
        """A payload that the store may keep; the buffer of a message is reused."""
        ...

    def run(self, work: Callable[[T], U], items: Sequence[T]) -> list[U]:
        """``work`` on each of ``items``, in order."""
        ...


def open_tile(codec: TileCodec, first: First) -> Opened:
    """Decode the payload of LoD 0. Raises :class:`DecodeError`."""
    state: AnyTile = codec.open_tile(first.payload, None if first.looks is None else anchors_of(first.looks))
    if isinstance(state, MotionTile):
        return OpenMotion(state)
    if isinstance(state, UpdateState):
        return OpenUpdate(state)
    low, high = axis_bounds(state.means) if len(state) else (np.zeros(3, np.float32), np.zeros(3, np.float32))
    return OpenTile(state, Sphere(((low + high) / 2).astype(np.float32), float(np.linalg.norm(high - low) / 2)))


def in_view(spheres: Sequence[Sphere], camera: Camera) -> NDArray[np.bool_]:
    """Mask of the ``spheres`` [n] that meet the cone around the view's pyramid."""
    centres, radii = np.array([s.centre for s in spheres], np.float64), np.array([s.radius for s in spheres])
    rotation, translation = camera.world_to_camera
    p = centres @ rotation.T + translation
    fov_x, fov_y = camera.intrinsics.fov_rad
    half = np.arctan(np.hypot(np.tan(fov_x / 2), np.tan(fov_y / 2)))
    distance = np.maximum(np.linalg.norm(p, axis=1), 1e-9)
    angle = np.arccos(np.clip(p[:, 2] / distance, -1.0, 1.0))
    spread = np.arcsin(np.clip(radii / distance, 0.0, 1.0))
    return np.asarray((angle <= half + spread) | (distance <= radii))


class TileOpener:
    """Decodes base layers and dequantises tiles on ``threads`` threads. The results do not depend on their number."""

    bounded = True

    def __init__(self, codec: TileCodec | None, threads: int) -> None:
        """``codec`` may be set later as :attr:`codec`, before a tile is opened."""
        self.codec, self.threads = codec, threads
        self._inside = threading.local()
        self._pool = ThreadPoolExecutor(threads, "cags-tiles", self._enter) if threads > 1 else None

    def _enter(self) -> None:
        self._inside.pool = True

    def opened(self, firsts: Sequence[First]) -> list[Opened | DecodeError]:
        """A decoder for each tile, or why it cannot be read."""
        return self.run(self._try, firsts)

    def looks_of(self, first: First) -> Key | None:
        """The looks that a tile of motion moves; None of other kinds, and where that cannot be read."""
        if first.lod or not len(first.payload) or first.payload[0] != MOTION_VERSION:
            return None
        try:
            return read_looks(first.payload)
        except DecodeError:
            return None

    def kept(self, payload: memoryview) -> bytes:
        """A copy."""
        return bytes(payload)

    def dequantise(self, tiles: Sequence[TileDecoder]) -> list[Splats]:
        """The splats of distinct ``tiles``."""
        return self.run(_dequantised, tiles)

    def run(self, work: Callable[[T], U], items: Sequence[T]) -> list[U]:
        """Results of ``work`` on each of ``items``, in order.

        Work that already runs in the pool opens its tiles sequentially: waiting for the pool's own threads would
        deadlock.
        """
        alone = self._pool is None or getattr(self._inside, "pool", False)
        return list(map(work, items) if alone or self._pool is None else self._pool.map(work, items))

    def merged(self, tiles: Sequence[TileDecoder], sh_degree: int) -> Splats:
        """All splats of distinct ``tiles``, in order."""
        return dequantise_tiles(tiles, sh_degree, self._pool.map if self._pool else map)

    def _try(self, first: First) -> Opened | DecodeError:
        try:
            assert self.codec is not None, "tiles came before the codec that reads them"
            return open_tile(self.codec, first)
        except DecodeError as error:
            return error


def _dequantised(tile: TileDecoder) -> Splats:
    return tile.dequantise()
