"""When a first picture is shown before all of it has come."""

from __future__ import annotations

import uuid

import numpy as np
import pytest

from cags_common.geometry import Camera, Pose
from cags_common.tiles.kinds import TileKind
from cags_protocol.wire.messages import FrameEnd, TileLayers
from cags_server.session.startup import PATIENCE_US, FirstFrame
from cags_server.visibility.bounds import guessed_looks, opening_tiles
from support.moving_bundle import FRAMES, moving_library
from support.server_scene import hello, library

KEYS = [(0, tile) for tile in range(8)]


def arrived(first: FirstFrame, *tiles: int) -> None:
    for tile in tiles:
        first.settled(TileLayers(0, tile, 0, 1, (1,), (0,)))


def test_on_a_slow_link_the_play_begins_with_what_is_nearest() -> None:
    first = FirstFrame(5, KEYS, 1000)
    assert first.due_us() is None, "nothing to show yet"
    arrived(first, 0)
    assert first.end(1000 + 10 * PATIENCE_US) == []
    arrived(first, 1)
    assert first.due_us() == 1000 + PATIENCE_US
    assert first.end(1000 + PATIENCE_US - 1) == []
    assert first.end(1000 + PATIENCE_US) == [FrameEnd(5)]
    assert first.end(1000 + 2 * PATIENCE_US) == [], "once"
    assert first.due_us() is None


def test_on_a_fast_link_there_is_nothing_to_do() -> None:
    first = FirstFrame(0, KEYS, 0)
    arrived(first, *range(8))
    assert first.due_us() is None
    assert first.end(PATIENCE_US) == []


def test_nothing_in_view_waits_for_nothing() -> None:
    assert FirstFrame(0, [], 0).due_us() is None


def test_without_a_render_splats_in_view_share_the_picture_and_near_ones_take_more() -> None:
    scene = library()
    shares = []
    for pose in (Pose.identity(), Pose.looking_at((0, 0, 0), (0, 0, -5))):
        camera = Camera(hello().intrinsics, pose, 0.05)
        guess = guessed_looks(scene, 0, camera, 120_000)
        in_view, hidden = opening_tiles(scene, 0, camera)
        assert len(in_view) + len(hidden) == len(np.unique(scene.owners(0)))
        visible = {(tile.frame, tile.tile): tile for tile in scene.tiles_of_looks(0, guess)}
        assert sorted(visible) == sorted(in_view)
        assert guess.weights.sum() == pytest.approx(120_000 if in_view else 0.0)
        of_one = [visible[key].weight / visible[key].count for key in in_view]
        assert of_one == sorted(of_one, reverse=True)
        shares.append(guess.weights.tolist())
    assert shares[0] != shares[1]


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_each_tile_in_view_is_followed_by_its_motion_and_all_by_the_updates_in_force(seed: int) -> None:
    scene = moving_library(f"memory://{uuid.uuid4().hex}", seed)
    camera = Camera(hello().intrinsics, Pose.identity(), 0.05)
    for frame in range(FRAMES):
        tiles = scene.tile_map(frame)
        in_view, hidden = opening_tiles(scene, frame, camera)
        numbers = [tiles.number(*key) for key in in_view]
        kinds = [TileKind(tiles.kinds[n]) for n in numbers]
        assert kinds == sorted(kinds, key=lambda kind: kind == TileKind.UPDATE), "updates last"
        for at, (number, kind) in enumerate(zip(numbers, kinds, strict=True)):
            chunk = int(tiles.chunk_at(np.array([number], np.int32), frame)[0])
            if kind == TileKind.LOOKS and chunk >= 0:
                assert numbers[at + 1] == chunk
        assert {scene.entry(at).tiles[tile].kind for at, tile in hidden} <= {TileKind.LOOKS}
        assert {key for key in in_view if scene.entry(key[0]).tiles[key[1]].kind == TileKind.LOOKS} | set(hidden) == {
            tiles.key(int(n)) for n in np.unique(scene.owners(frame)) if n >= 0
        }
