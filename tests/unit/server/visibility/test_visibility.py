"""Which tiles a frame shows that gets no reference render of its own."""

from __future__ import annotations

import uuid
from dataclasses import replace

import numpy as np
import pytest

from cags_common.geometry import Camera, Pose
from cags_common.tiles.kinds import TileKind
from cags_protocol.wire.messages import TileLayers
from cags_server.visibility.age import VersionAge
from cags_server.visibility.bounds import guessed_looks
from cags_server.visibility.inventory import ClientInventory
from cags_server.visibility.visibility import Visibility
from support.moving_bundle import moving_library
from support.server_scene import hello, library

LEAST = 0.02
AHEAD = Camera(hello().intrinsics, Pose.identity(), 0.1)
BEHIND = Camera(hello().intrinsics, Pose.looking_at((0, 0, 0), (0, 0, -3), (0, -1, 0)), 0.1)


def seen(*ids: int) -> np.ndarray:
    """Contributions [40] of the scene's splats: 1 for those in view."""
    out = np.zeros(40, np.float32)
    out[list(ids)] = 1.0
    return out


def test_a_render_tells_of_its_own_group_of_frames_alone() -> None:
    sight = Visibility(library(), LEAST)
    assert not sight.tells_of(0)
    sight.rendered(2, seen(8), AHEAD)
    assert sight.tells_of(0) and sight.tells_of(5) and not sight.tells_of(6)
    assert [(tile.frame, tile.tile) for tile in sight.tiles(2)] == [(0, 0)]
    sight.rendered(7, seen(8), AHEAD)
    assert not sight.tells_of(5)


def test_a_splat_that_left_the_picture_while_it_changed_stays_in_visibility() -> None:
    sight = Visibility(library(), LEAST)
    sight.rendered(3, seen(3, 8), AHEAD)
    sight.served(3, seen(3, 8), ClientInventory())  # nothing is held yet: both are owed
    sight.rendered(4, seen(35), AHEAD)
    shown = {(tile.frame, tile.tile) for tile in sight.tiles(4)}
    assert len(shown) > 1, "more than the tile that is in the picture"
    sight.rendered(6, seen(35), AHEAD)
    assert len(sight.tiles(6)) == 1, "another group has other splats"


def test_without_a_render_the_tiles_bounds_say_what_is_in_view() -> None:
    sight = Visibility(library(), LEAST)
    assert len(sight.guessed_tiles(0, AHEAD, 64 * 48)) == 4
    assert sight.guessed_tiles(0, BEHIND, 64 * 48) == ()


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_a_guess_by_tiles_is_one_by_splats(seed: int) -> None:
    scene = moving_library(f"memory://{uuid.uuid4().hex}", seed)
    camera = Camera(hello().intrinsics, Pose.looking_at((0, 0, 0), (0, 0, -5)), 0.05)
    for frame in range(scene.manifest.frames):
        owners, guess = scene.owners(frame), guessed_looks(scene, frame, camera, 120_000)
        contribution = np.zeros(len(owners), np.float32)
        for number, count, weight in zip(guess.numbers, guess.counts, guess.weights, strict=True):
            assert count == (owners == number).sum()
            contribution[owners == number] = weight / count
        found, wanted = scene.tiles_of_looks(frame, guess), scene.visible_tiles(frame, contribution, 0.0)
        assert [replace(tile, weight=0.0) for tile in found] == [replace(tile, weight=0.0) for tile in wanted]
        assert [tile.weight for tile in found] == pytest.approx([tile.weight for tile in wanted], rel=1e-5)


def test_what_is_shown_is_looked_up_again_when_it_changes() -> None:
    served = library()
    sight, age = Visibility(served, LEAST), VersionAge(served)
    ahead = Camera(hello().intrinsics, Pose.identity(), 0.1)
    inventory = ClientInventory()
    for tile in range(4):
        age.sent(0, tile)
        inventory.delivered(TileLayers(0, tile, 0, 1, (1,), (0,)))
    late = {(t.frame, t.tile) for t in sight.with_ghosts((), 4, ahead, inventory, age)}
    assert late, "splats have changed by frame 4"
    assert {(t.frame, t.tile) for t in sight.with_ghosts((), 0, ahead, inventory, age)} == set()
    for key in late:
        age.sent(*key)
        inventory.delivered(TileLayers(*key, 0, 1, (1,), (0,)))
    assert sight.with_ghosts((), 4, ahead, inventory, age) == ()
    for key in late:
        age.lost(*key)
        inventory.reduced(*key, 0)
    assert sight.with_ghosts((), 4, ahead, inventory, age) == (), "nothing of them is shown"


def test_splats_that_appear_after_the_last_render_count_like_the_average_splat_where_they_are_in_view() -> None:
    """In real time, a busy server renders rarely: what appeared in between was not sent before the next render."""
    sight = Visibility(library(born=4), LEAST)
    birth = (3, 0)
    sight.rendered(1, seen(5, 8, 9), AHEAD)
    assert birth not in {(tile.frame, tile.tile) for tile in sight.tiles(2)}
    found = {(tile.frame, tile.tile): tile for tile in sight.tiles(3)}[birth]
    assert found.count == 4 and found.weight == pytest.approx(4 * 3 / 36)
    sight.rendered(1, seen(5, 8, 9), BEHIND)
    assert birth not in {(tile.frame, tile.tile) for tile in sight.tiles(3)}
    sight.rendered(3, seen(5, 8, 9), AHEAD)
    assert birth not in {(tile.frame, tile.tile) for tile in sight.tiles(3)}, "this render shows that they are hidden"


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_whatever_has_appeared_since_the_last_render_is_planned(seed: int) -> None:
    scene = moving_library(f"memory://{uuid.uuid4()}", seed)
    sight = Visibility(scene, LEAST)
    frames = scene.manifest.gof_frames(0)
    camera = Camera(hello().intrinsics, Pose.looking_at((0, 0, -1000), (0, 0, 0)), 0.1)
    first = scene.owners(frames[0])
    sight.rendered(frames[0], (first >= 0).astype(np.float32), camera)
    for frame in frames[1:]:
        looks = {(tile.frame, tile.tile) for tile in sight.tiles(frame) if tile.kind == TileKind.LOOKS}
        owners = scene.owners(frame)
        everyone = {scene.tile_of(frame, int(number)) for number in np.unique(owners[owners >= 0])}
        assert looks == everyone


def test_the_owners_of_a_render_long_past_are_not_traced_again(monkeypatch: pytest.MonkeyPatch) -> None:
    served = moving_library(f"memory://{uuid.uuid4()}", 1)
    sight, asked = Visibility(served, LEAST), []
    sight.rendered(0, np.ones(served.manifest.capacity[0], np.float32), AHEAD)
    owners = served.owners
    monkeypatch.setattr(served, "owners", lambda frame: asked.append(frame) or owners(frame))
    assert sight.tiles(3)
    assert asked and 0 not in asked
