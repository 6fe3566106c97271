"""What the server knows of a scene: how long a splat stays."""

from __future__ import annotations

import numpy as np
import pytest

from support.server_scene import library


def test_frames_left_are_those_until_the_media_replaces_a_splat() -> None:
    scene = library(splats=3)  # frame n changes splat n % 3, frame 2 removes splat 2
    assert scene.manifest.gof_frames(0)[-1] >= 4
    every = np.ones(scene.manifest.capacity[0], np.float32)
    left = {(tile.frame, tile.tile): tile.frames_left for tile in scene.visible_tiles(1, every, 0.5)}
    assert left[1, 0] == 3.0, "splat 1, which comes again in frame 4"
    of_key_frame = [value for (frame, _), value in left.items() if frame == 0]
    assert sorted(of_key_frame) in ([1.0, 2.0], [1.5]), "splat 0 goes in frame 3, splat 2 in frame 2"


def test_a_loop_is_traced_once_however_many_frames_it_has(monkeypatch) -> None:
    scene = library(splats=40, frames=150, gof=150)
    every = np.ones(scene.manifest.capacity[0], np.float32)
    first = [scene.visible_tiles(frame, every, 0.5) for frame in range(150)]
    traced: list[int] = []
    monkeypatch.setattr(scene, "_trace_owners", lambda gof, frame, known: traced.append(frame))
    assert [scene.visible_tiles(frame, every, 0.5) for frame in range(150)] == first
    assert traced == []


def test_frames_are_made_ready_ahead_up_to_the_last() -> None:
    scene = library(splats=3)
    last = scene.manifest.frames - 1
    assert not scene.at_hand(last)
    assert all(scene.read_ahead(frame) for frame in range(last + 1))
    assert all(scene.at_hand(frame) for frame in range(last + 1))
    assert not scene.read_ahead(last + 1)


def test_nothing_is_made_ready_ahead_beyond_half_the_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = library(splats=3)
    assert scene.read_ahead(0) and scene.read_ahead(1)
    monkeypatch.setattr("cags_server.scene.source_scenes.CACHED_DELTA_BYTES", 8)
    assert not scene.read_ahead(2)
