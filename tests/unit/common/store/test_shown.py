"""Figures of the detail on display."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.store.shown import Shown, StoredLooks
from cags_common.store.tile_decode import Sphere
from cags_common.store.versions import Versions

CAMERA = Camera(Intrinsics.of_fov(40, 30, 0.5, 0.4), Pose.identity())
AHEAD, BEHIND = (0.0, 0.0, 5.0), (0.0, 0.0, -5.0)


def held(index: int, owned: int, lod: int, at: tuple[float, float, float] = AHEAD) -> StoredLooks:
    sphere, versions = Sphere(np.array(at, np.float32), 0.1), Versions(SimpleNamespace(), 0)  # type: ignore[type-var]
    return StoredLooks(index=index, key=(0, index), sphere=sphere, versions=versions, owned=owned, shown_lod=lod)


def shown(*tiles: StoredLooks) -> Shown:
    owner = [-1] + [tile.index for tile in tiles for _ in range(tile.owned)]
    return Shown(np.array(owner, np.int32), tiles)


def test_without_contributions_splats_of_tiles_in_view_count() -> None:
    scene = shown(held(0, 3, 2), held(1, 1, 6), held(2, 5, 9, BEHIND), held(3, 0, 9))
    assert scene.lod_mean(CAMERA) == pytest.approx((3 * 2 + 6) / 4)
    assert scene.splats == 9
    assert np.isnan(shown(held(0, 2, 1, BEHIND)).lod_mean(CAMERA))


def test_the_error_is_the_mean_of_errors_and_not_that_of_the_mean_detail() -> None:
    errors = np.array([1e-2, 1e-3, 1e-4])
    scene = shown(held(0, 1, 0), held(1, 3, 2), held(2, 9, 1, BEHIND))
    assert scene.error_mean(CAMERA, errors) == pytest.approx(2.575e-3)
    assert np.isnan(Shown(np.array([-1], np.int32), ()).error_mean(CAMERA, errors))


def test_with_contributions_what_is_seen_counts() -> None:
    scene = shown(held(0, 2, 2), held(1, 1, 6, BEHIND))
    assert scene.lod_mean(CAMERA, np.array([9, 0.5, 0.5, 3], np.float32)) == pytest.approx((2 + 3 * 6) / 4)
    assert np.isnan(scene.lod_mean(CAMERA, np.array([9, 0, 0, 0], np.float32)))
    assert scene.visible_lods(np.array([9, 0, 0, 3], np.float32)) == {(0, 1): 7}


def test_nothing_shown_has_no_detail_and_is_full() -> None:
    empty = Shown(np.array([-1, -1], np.int32), ())
    assert np.isnan(empty.lod_mean(CAMERA))
    assert np.isnan(empty.lod_mean(CAMERA, np.ones(2, np.float32)))
    assert empty.full(3)
    assert empty.lods().shape == (0,)


def test_full_asks_only_of_tiles_that_own_something() -> None:
    assert shown(held(0, 1, 3), held(1, 0, 1)).full(3)
    assert not shown(held(0, 1, 3), held(1, 1, 2)).full(3)
