"""A small scene in memory, in place of a bundle: a wall of splats, some of which change in every frame."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from cags_common.bundle import FrameEntry, Manifest, SourceDelta, SourceFrame, TileEntry
from cags_common.coding.packing import crc32, encode_ids
from cags_common.geometry import F32, Intrinsics, Pose
from cags_common.motion.neighbours import Anchors
from cags_common.raster.base import RenderedView
from cags_common.splats import Ids, Splats
from cags_common.tiles.lod import LodLayer
from cags_common.tiles.splat_buffer import MOVING_COLUMNS
from cags_protocol.wire.limits import PROTOCOL_VERSION
from cags_protocol.wire.messages import Hello
from cags_server.scene.library import SceneLibrary
from cags_server.settings import ServerSettings

FPS, FRAMES = 30.0, 12
PAYLOAD_FRAMES = 256
"""A payload names its frame in one byte."""
CLIENT = Intrinsics.of_fov(160, 120, 1.2, 0.95)
SETTINGS = ServerSettings(
    reference_width=64,
    reference_height=48,
    rasteriser="oracle",
    fov="fixed",
    fov_margin=0.1,
    abr="paper",
    tiles_ahead=1,
    reserve_s=0.0,
)
BIRTH = 3
"""Frame of a group at which splats are born."""
COLOUR = 0.5
"""Of every splat of the scene; a client's come closer to it with every LoD, and never there."""


def hello(pose: Pose | None = None, **changes: Any) -> Hello:
    return replace(Hello(PROTOCOL_VERSION, CLIENT, pose or Pose.identity()), **changes)


def wall(count: int, frame: int = 0) -> Splats:
    """Splats in a row along X, three metres ahead of the origin."""
    means = np.zeros((count, 3), np.float32)
    means[:, 0] = np.linspace(-2, 2, count)
    means[:, 2] = 3.0 + 0.01 * frame
    quats = np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1))
    ones = np.ones((count, 3), np.float32)
    rest = np.zeros((count, 0, 3), np.float32)
    return Splats(means, quats, -3 * ones, np.full(count, 3, np.float32), COLOUR * ones, rest)


class WallTile:
    """A decoded tile of the wall (:class:`~cags_common.bundle.codecs.TileDecoder`)."""

    steps = None
    grows = False

    def __init__(self, ids: Ids, splats: Splats, lod: int, *, lossy: bool) -> None:
        self.ids, self._splats, self.lod, self._lossy = ids, splats, lod, lossy

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def means(self) -> F32:
        return self._splats.means

    def add_layer(self, lod: int, payload: bytes | memoryview) -> bool:
        assert payload[2] == lod, "the payload of another LoD"
        self.lod = max(self.lod, lod)
        return True

    def fork(self) -> WallTile:
        return copy(self)

    def dequantise(self, into: Splats | None = None) -> Splats:
        share = 1 - 0.5 / (2 + self.lod) if self._lossy else 1.0
        colour = np.full_like(self._splats.sh0, COLOUR * share)
        return replace(self._splats, sh0=colour).written_to(into)


class WallCodec:
    """Reads what :meth:`FakeReader.payload` wrote: which tile of which frame it is, and of which LoD."""

    def __init__(self, reader: FakeReader) -> None:
        self._reader = reader

    def open_tile(self, payload: bytes | memoryview, anchors: Anchors | None = None) -> WallTile:
        del anchors  # nothing moves by chunks
        frame, tile, lod = payload[:3]
        ids = FakeReader.tile_ids(self._reader, frame, tile)
        return WallTile(ids, wall(self._reader.splats, frame).take(ids), lod, lossy=self._reader.lossy)


class FakeReader:
    """The part of :class:`~cags_common.bundle.BundleReader` that the server uses."""

    def __init__(
        self,
        splats: int = 40,
        frames: int = FRAMES,
        gof: int = 6,
        tile_splats: int = 10,
        lods: int = 4,
        *,
        born: int = 0,
        lossy: bool = True,
    ) -> None:
        """``born``: so many splats are there from the fourth frame of a group on; ``lossy``: clients show it worse."""
        self.lossy, self._born = lossy, born
        starts = tuple(range(0, frames, gof))
        order = tuple(LodLayer("scale", layer) for layer in range(1, lods))
        self.manifest = Manifest(
            "wall", FPS, frames, starts, (splats,) * len(starts), 0, ((-2, 0, 3), (2, 0, 4)), order,
            tuple(1.0 / (1 + i) for i in range(lods - 1)), "svq", "paper-66",
        )  # fmt: skip
        assert frames < PAYLOAD_FRAMES
        self.splats, self._lods, self._tile_splats = splats, lods, tile_splats
        self.codec = WallCodec(self)
        self._entries = [self._entry(f) for f in range(frames)]

    def codebooks(self) -> bytes:
        return b"codebooks"

    def base_codebooks(self) -> bytes | None:
        return None

    def weights(self) -> bytes | None:
        return None

    def frame(self, frame: int) -> FrameEntry:
        return self._entries[frame]

    def at_hand(self, frame: int) -> bool:
        return True

    def payload(self, frame: int, tile: int, lod: int) -> bytes:
        return bytes([frame, tile, lod]) * (40 if lod == 0 else 10)

    def open_tile(self, frame: int, tile: int, lod: int = 0) -> WallTile:
        return self.codec.open_tile(self.payload(frame, tile, lod))

    def tile_ids(self, frame: int, tile: int) -> Ids:
        first = tile * self._tile_splats
        if frame in self.manifest.gof_starts:
            return np.arange(first, min(first + self._tile_splats, self.splats - self._born), dtype=np.int32)
        if self._born and self._age(frame) == BIRTH:
            return np.arange(self.splats - self._born, self.splats, dtype=np.int32)
        return np.array([frame % (self.splats - self._born)], np.int32)

    def _age(self, frame: int) -> int:
        return frame - self.manifest.gof_starts[self.manifest.gof_of(frame)]

    def _alive(self, frame: int) -> Ids:
        return np.arange(self.splats - self._born * (self._age(frame) < BIRTH), dtype=np.int32)

    def removed_ids(self, frame: int) -> Ids:
        return np.array([self.splats - 1], np.int32) if frame == 2 and not self._born else np.zeros(0, np.int32)

    def removed_payload(self, frame: int) -> bytes:
        return encode_ids(self.removed_ids(frame))

    def source(self, frame: int) -> SourceFrame:
        ids = self._alive(frame)
        return SourceFrame(ids, wall(self.splats, frame).take(ids))

    def source_delta(self, frame: int) -> SourceDelta:
        birth = self._born and self._age(frame) == BIRTH
        ids = self._alive(frame) if birth or frame in self.manifest.gof_starts else np.zeros(1, np.int32)
        return SourceDelta(ids, wall(self.splats, frame).take(ids), self.removed_ids(frame))

    def _entry(self, frame: int) -> FrameEntry:
        key = frame in self.manifest.gof_starts
        count = -(-(self.splats - self._born) // self._tile_splats) if key else 1
        tiles = tuple(self._tile(frame, tile) for tile in range(count))
        return FrameEntry(frame, key, self.manifest.gof_of(frame), tiles, len(self.removed_ids(frame)), 0, 0, 0)

    def _tile(self, frame: int, tile: int) -> TileEntry:
        ids = self.tile_ids(frame, tile)
        means = wall(self.splats, frame).means[ids].astype(float)
        low, high = tuple(means.min(axis=0).tolist()), tuple(means.max(axis=0).tolist())
        payloads = [self.payload(frame, tile, lod) for lod in range(self._lods)]
        sizes, crcs = tuple(map(len, payloads)), tuple(map(crc32, payloads))
        return TileEntry(tile, len(ids), int(ids[0]), (low, high), sizes, crcs)


class FakeScene:
    """Every splat that projects into the picture contributes one pixel; the picture has the mean of their colours."""

    def __init__(self, splats: Splats) -> None:
        self._splats = Splats(**{name: array.copy() for name, array in splats.arrays()})

    def __len__(self) -> int:
        return len(self._splats)

    def update(self, rows: Any, splats: Splats, threads: int = 1) -> None:
        for (_, target), (_, values) in zip(self._splats.arrays(), splats.arrays(), strict=True):
            target[rows] = values[rows]

    def move(self, rows: Any, splats: Splats, threads: int = 1) -> None:
        for name in MOVING_COLUMNS:
            getattr(self._splats, name)[rows] = getattr(splats, name)[rows]

    def render(self, camera: Any, options: Any) -> RenderedView:
        rotation, translation = camera.world_to_camera
        x, y, z = (self._splats.means @ rotation.T + translation).T
        k = camera.intrinsics
        alive = self._splats.logit_opacities > -10
        z = np.where(z == 0, 1e-9, z)
        seen = alive & (z > camera.near)
        seen &= (abs(x / z * k.fx_px) < k.width_px / 2) & (abs(y / z * k.fy_px) < k.height_px / 2)
        colour = self._splats.sh0[seen].mean(axis=0) if seen.any() else np.zeros(3, np.float32)
        image = np.tile(colour.astype(np.float32), (k.height_px, k.width_px, 1))
        return RenderedView(image, image[..., 0], None, seen.astype(np.float32))


def library(reader: FakeReader | None = None, **options: Any) -> SceneLibrary:
    reader = reader or FakeReader(**options)
    rasteriser: Any = SimpleNamespace(name="fake", load=FakeScene)
    return SceneLibrary(cast(Any, reader), rasteriser)
