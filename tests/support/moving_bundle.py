"""Small bundles of every kind of tile, made by hand: looks, chunks of motion, updates, splats that come and go."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from cags_common.bundle import (
    BundlePlayer,
    BundleReader,
    BundleWriter,
    LodLayer,
    Manifest,
    SourceDelta,
    SourceFrame,
    TilePayloads,
)
from cags_common.bundle.manifest import MotionSteps
from cags_common.bundle.source import encode_source
from cags_common.geometry import F32, Vec3
from cags_common.motion import chunk
from cags_common.motion.neighbours import Anchors
from cags_common.splats import Ids, Splats
from cags_common.tiles.kinds import TileKind
from cags_common.tiles.lod import POSITION
from cags_common.tiles.payloads import (
    PositionGrid,
    decode_base,
    encode_base,
    encode_layer,
    encode_position_layer,
)
from cags_common.tiles.updates import RAMP_COLUMNS, encode_update
from cags_server.scene.library import SceneLibrary
from support.codec_scenes import books
from support.server_scene import FakeScene

BOOKS = books((4, 2))
_FIRST, *_OTHERS = (LodLayer(name, 1) for name in BOOKS.attributes)
ORDER = (_FIRST, LodLayer(POSITION, 1), *_OTHERS, LodLayer(POSITION, 2))
LODS = len(ORDER) + 1
POSITION_LAYERS = 2, 0, 1
"""Layers of positions of tiles, in turn."""
STEP_M = 0.02
"""Finest unit of positions, metres."""
TURN_STEP = 0.01

GROUP, FRAMES = 7, 14
NOBODY = np.zeros(0, np.int32)


class PlayedReader(BundleReader):
    """A bundle whose source is what a player of all of it shows."""

    played: dict[int, SourceFrame]

    @classmethod
    def of(cls, url: str) -> PlayedReader:
        """The bundle at ``url``, played once."""
        reader = cast(PlayedReader, cls.open(url))
        player = BundlePlayer(reader)
        reader.played = {frame: player.frame(frame) for frame in range(reader.manifest.frames)}
        return reader

    def source(self, frame: int) -> SourceFrame:
        return self.played[frame]

    def source_delta(self, frame: int) -> SourceDelta:
        now = self.played[frame]
        before = NOBODY if frame in self.manifest.gof_starts else self.played[frame - 1].ids
        return SourceDelta(now.ids, now.splats, np.setdiff1d(before, now.ids).astype(np.int32))


@dataclass
class _Track:
    looks: tuple[int, int]
    ids: Ids
    means: F32
    anchors: Anchors
    begins: int  # the frame of the next chunk


class MovingScene:
    """Draws tiles of one group of frames at random; what it says of lives, owners and motion is consistent."""

    def __init__(self, seed: int, first: int, frames: int, *, motion: bool = True) -> None:
        self._random, self._first, self._end = np.random.default_rng(seed), first, first + frames
        self._motion = motion
        self._deaths: dict[int, int] = {}  # id -> frame from which it is gone
        self._tracks: list[_Track] = []
        self._ids = 0

    @property
    def capacity(self) -> int:
        return self._ids

    def frame(self, frame: int) -> tuple[list[TilePayloads], Ids]:
        """Tiles of ``frame``, and the ids that it removes."""
        key = frame == self._first
        alive = np.array([i for i, end in self._deaths.items() if end > frame], np.int32)
        removed = np.array(sorted(i for i, end in self._deaths.items() if end == frame), np.int32)
        tiles = [self._looks(frame, number, self._born(frame, 6), key=True) for number in range(3) if key]
        if not key and self._random.random() < 0.5:
            tiles.append(self._looks(frame, len(tiles), self._born(frame, 3), key=False))
        again = self._some(alive)
        if not key and len(again) and self._random.random() < 0.3:
            tiles.append(self._looks(frame, len(tiles), again, key=False))
            alive = np.setdiff1d(alive, again).astype(np.int32)
        changed = self._some(alive)
        if not key and len(changed) and self._random.random() < 0.6 and self._motion:
            tiles.append(self._update(changed))
        return tiles + self._chunks(frame), removed

    def _born(self, frame: int, count: int) -> Ids:
        ids = np.arange(self._ids, self._ids + count, dtype=np.int32)
        self._ids += count
        for each in ids.tolist():
            self._deaths[each] = int(self._random.integers(frame + 1, self._end + 6))
        return ids

    def _some(self, ids: Ids) -> Ids:
        return np.sort(self._random.permutation(ids)[: self._random.integers(0, 4)])

    def _looks(self, frame: int, number: int, ids: Ids, *, key: bool) -> TilePayloads:
        means = self._random.uniform([-4, -1, 2], [4, 1, 5], (len(ids), 3)).astype(np.float32)
        base = {name: self._random.integers(0, 16, len(ids)).astype(np.uint32) for name in BOOKS.attributes}
        grid = PositionGrid.over(means, 12, POSITION_LAYERS[number % 3])
        layers = [self._layer(item, means, grid) for item in ORDER]
        first = encode_base(ids, means, base, grid, BOOKS, id_range=key)
        if self._motion:
            ends_soon = any(self._deaths[each] <= frame + 1 for each in ids.tolist())
            begins = frame if ends_soon else frame + int(self._random.integers(0, 2))
            self._tracks.append(_Track((frame, number), ids, means, _anchors(first), begins))
        return TilePayloads(len(ids), int(ids[0]) if key else None, _corners(means), (first, *layers))

    def _layer(self, item: LodLayer, means: F32, grid: PositionGrid) -> bytes:
        if item.attribute == POSITION:
            return encode_position_layer(means, grid, item.layer)
        return encode_layer(self._random.integers(0, 4, len(means)).astype(np.uint32), 2)

    def _update(self, ids: Ids) -> TilePayloads:
        names = [name for name in BOOKS.attributes if not name.startswith("rotation")]
        masks = {name: (self._random.random(len(ids)) < 0.5) & (name in names) for name in BOOKS.attributes}
        codes = {name: self._random.integers(0, 64, len(ids)).astype(np.uint32) for name in BOOKS.attributes}
        corner = (-4.0, -1.0, 2.0), (4.0, 1.0, 5.0)
        frames = {column: self._random.integers(1, 6, len(ids)).astype(np.uint8) for column in RAMP_COLUMNS}
        payloads = encode_update(ids, masks, codes, BOOKS, ORDER, frames)
        return TilePayloads(len(ids), None, corner, payloads, TileKind.UPDATE)

    def _chunks(self, frame: int) -> list[TilePayloads]:
        out: list[TilePayloads] = []
        for track in self._tracks:
            span = min(int(self._random.integers(1, 4)), self._end - 1 - frame)
            if track.begins == frame and span and any(self._deaths[each] > frame for each in track.ids.tolist()):
                track.begins = frame + span
                out.append(self._chunk(track, frame, span))
        return out

    def _chunk(self, track: _Track, frame: int, span: int) -> TilePayloads:
        count = len(track.ids)
        lives = np.array([np.clip(self._deaths[each] - frame, 0, span + 1) for each in track.ids.tolist()], np.uint8)
        moves = self._random.normal(0, 40, (span + 1, count, 3))
        payloads = chunk.encode(track.looks, track.anchors, moves, None, starts=True, lives=lives)
        bounds = _corners((track.means + moves * STEP_M).reshape(-1, 3))
        return TilePayloads(count, None, bounds, payloads, TileKind.MOTION, track.looks, span)


def _anchors(base: bytes) -> Anchors:
    """Of looks whose LoD 0 is ``base``."""
    means = decode_base(base, BOOKS).means
    return Anchors(means, *(np.full(len(means), step, np.float32) for step in (STEP_M, TURN_STEP)))


def _corners(means: np.ndarray) -> tuple[Vec3, Vec3]:
    low, high = means.min(axis=0).tolist(), means.max(axis=0).tolist()
    return (low[0], low[1], low[2]), (high[0], high[1], high[2])


def write_moving(url: str, seed: int, *, motion: bool = True) -> PlayedReader:
    """A bundle of two groups of frames, drawn by ``seed``; without ``motion`` of looks and removed ids alone."""
    starts, capacities = tuple(range(0, FRAMES, GROUP)), []
    nothing = encode_source(SourceDelta(NOBODY, _no_splats(), NOBODY))
    with BundleWriter(url) as writer:
        writer.codebooks(BOOKS.to_bytes())
        for start in starts:
            scene, group = MovingScene(seed * 100 + start, start, GROUP, motion=motion), writer.open_gof(start, LODS)
            for frame in range(start, start + GROUP):
                group.frame(*scene.frame(frame), nothing)
            group.close()
            capacities.append(scene.capacity)
        steps = MotionSteps((STEP_M,) * 16, (TURN_STEP,) * 16) if motion else None
        box = (-5.0, -2.0, 1.0), (5.0, 2.0, 6.0)
        writer.commit(
            Manifest(
                "moving", 30.0, FRAMES, starts, tuple(capacities), 0, box, ORDER, (), "svq", "paper-66", motion=steps
            )
        )
    return PlayedReader.of(url)


def _no_splats() -> Splats:
    zeros = np.zeros((0, 3), np.float32)
    return Splats(
        zeros, np.zeros((0, 4), np.float32), zeros, np.zeros(0, np.float32), zeros, np.zeros((0, 0, 3), np.float32)
    )


def moving_library(url: str, seed: int, *, motion: bool = True) -> SceneLibrary:
    """Such a bundle, served with a renderer that sees every splat whose centre is in the picture."""
    rasteriser: Any = SimpleNamespace(name="fake", load=FakeScene)
    return SceneLibrary(write_moving(url, seed, motion=motion), rasteriser)
