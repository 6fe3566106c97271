"""Opening tiles, several at a time: Draco and the kernels release the GIL, so that two threads pay off."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from cags_common.codecs import AnyTile, MotionTile, TileCodec, TileDecoder, dequantise_tiles
from cags_common.errors import DecodeError
from cags_common.geometry import F32, Camera, axis_bounds
from cags_common.splats import Splats
from cags_common.updates import UpdateState

T = TypeVar("T")
U = TypeVar("U")


@dataclass(frozen=True, slots=True)
class Arrival:
    """Layers of one tile as a message brings them: ``payloads[i]`` is LoD ``from_lod + i``."""

    frame: int
    tile: int
    from_lod: int
    payloads: list[memoryview]

    @property
    def key(self) -> tuple[int, int]:
        """Source frame and tile."""
        return self.frame, self.tile


@dataclass(frozen=True, eq=False)
class OpenTile:
    """A decoded base layer of looks, and the sphere that holds its means."""

    state: TileDecoder
    centre: F32  # [3]
    radius: float


Opened: TypeAlias = OpenTile | MotionTile | UpdateState
"""A tile of any kind whose LoD 0 is decoded."""


def open_tile(codec: TileCodec, payload: memoryview) -> Opened:
    """Decode LoD 0. Raises :class:`DecodeError`."""
    state: AnyTile = codec.open_tile(payload)
    if isinstance(state, MotionTile | UpdateState):
        return state
    low, high = axis_bounds(state.means) if len(state) else (np.zeros(3, np.float32), np.zeros(3, np.float32))
    return OpenTile(state, ((low + high) / 2).astype(np.float32), float(np.linalg.norm(high - low) / 2))


def in_view(tiles: Sequence[OpenTile], camera: Camera) -> NDArray[np.bool_]:
    """Which tiles' spheres [tiles] meet the cone around the view's pyramid."""
    centres, radii = np.array([t.centre for t in tiles], np.float64), np.array([t.radius for t in tiles])
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

    def __init__(self, codec: TileCodec, threads: int) -> None:
        self._codec, self.threads = codec, threads
        self._pool = ThreadPoolExecutor(threads, "cags-tiles") if threads > 1 else None

    def open(self, payloads: Sequence[memoryview]) -> list[Opened | DecodeError]:
        """What each LoD 0 payload holds, or why it cannot be read."""
        return list(self._pool.map(self._try, payloads) if self._pool else map(self._try, payloads))

    def dequantise(self, tiles: Sequence[TileDecoder]) -> list[Splats]:
        """Each tile's splats; the tiles are different ones."""
        return self.run(_dequantised, tiles)

    def run(self, work: Callable[[T], U], items: Sequence[T]) -> list[U]:
        """``work`` on each of ``items``, in order."""
        return list(self._pool.map(work, items) if self._pool else map(work, items))

    def merged(self, tiles: Sequence[TileDecoder], sh_degree: int) -> Splats:
        """All splats of different ``tiles`` in order."""
        return dequantise_tiles(tiles, sh_degree, self._pool.map if self._pool else map)

    def _try(self, payload: memoryview) -> Opened | DecodeError:
        try:
            return open_tile(self._codec, payload)
        except DecodeError as error:
            return error


def _dequantised(tile: TileDecoder) -> Splats:
    return tile.dequantise()
