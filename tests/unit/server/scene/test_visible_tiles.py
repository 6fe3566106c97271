"""Which tiles bring what is seen, and for how long."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cags_common.bundle.codecs import MotionTile
from cags_common.tiles.kinds import TileKind
from cags_common.tiles.updates import UpdateState
from cags_server.scene.library import SceneLibrary
from cags_server.scene.visible_tiles import CHUNK_AHEAD
from support.moving_bundle import FRAMES, GROUP, moving_library


@pytest.fixture(scope="module", params=[3, 4, 5, 6])
def scene(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> SceneLibrary:
    return moving_library(str(Path(tmp_path_factory.mktemp("moving")) / "bundle"), request.param)


def everything(scene: SceneLibrary, frame: int) -> np.ndarray:
    return np.ones(scene.manifest.capacity[scene.manifest.gof_of(frame)], np.float32)


def test_looks_are_of_the_newest_tile_and_motion_of_the_chunk_that_holds(scene: SceneLibrary) -> None:
    for frame in range(FRAMES):
        tiles, visible = scene.tile_map(frame), scene.visible_tiles(frame, everything(scene, frame), 0.5)
        looks = {(t.frame, t.tile) for t in visible if t.kind == TileKind.LOOKS}
        assert looks == {tiles.key(int(n)) for n in np.unique(scene.owners(frame)) if n >= 0}
        for tile in (t for t in visible if t.kind == TileKind.MOTION):
            assert tile.looks in looks and tile.frames_left > 0
            chunk = scene.reader.open_tile(tile.frame, tile.tile)
            assert isinstance(chunk, MotionTile) and chunk.looks == tile.looks
            newest = tiles.chunk_at(np.array([tiles.number(*tile.looks)], np.int32), frame)
            ahead = tile.frame - frame
            assert tiles.number(tile.frame, tile.tile) == newest[0] or 0 < ahead <= CHUNK_AHEAD


def test_updates_count_while_one_of_their_attributes_is_the_newest(scene: SceneLibrary) -> None:
    for frame in range(FRAMES):
        first = scene.gof_start(frame)
        newest: dict[tuple[int, str], tuple[int, int] | None] = {}
        alive = set(np.flatnonzero(scene.owners(frame) >= 0).tolist())
        for at in range(first, frame + 1):
            for entry in scene.entry(at).tiles:
                if entry.kind == TileKind.MOTION:
                    continue
                state = scene.reader.open_tile(at, entry.tile)
                for name in ("scale", "opacity", "sh0"):
                    ids = state.ids[state.changed[name]] if isinstance(state, UpdateState) else state.ids
                    key = (at, entry.tile) if isinstance(state, UpdateState) else None
                    newest |= {(int(i), name): key for i in ids}
        in_force = {key for (i, _), key in newest.items() if key is not None and i in alive}
        visible = scene.visible_tiles(frame, everything(scene, frame), 0.5)
        assert {(t.frame, t.tile) for t in visible if t.kind == TileKind.UPDATE} == in_force


def test_the_last_frame_of_a_group_leaves_one_frame(scene: SceneLibrary) -> None:
    for tile in scene.visible_tiles(GROUP - 1, everything(scene, GROUP - 1), 0.5):
        assert tile.frames_left == 1


def test_a_splat_that_nobody_sees_brings_no_tile(scene: SceneLibrary) -> None:
    assert scene.visible_tiles(3, 0 * everything(scene, 3), 0.0) == ()
