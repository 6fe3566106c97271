"""The colour adapter: towards the reference, within bounds, and forgetful where splats have changed."""

from dataclasses import replace

import numpy as np
import pytest

from cags_client.adapt import MAX_CHANGE, SirtAdapter
from cags_client.align import ReferencePicture
from cags_common import raster
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.metrics import psnr
from cags_common.raster.base import Footprint, RasterScene, RenderedView, RenderOptions
from cags_common.splats import SH_C0, Splats
from cags_encoder.scenes import open_scene

CLIENT = Intrinsics.of_fov(160, 120, 1.0, 0.8)
CAMERA = Camera(Intrinsics.of_fov(80, 60, 1.1, 0.9), Pose.identity())
OPTIONS = RenderOptions(footprint=Footprint.of(CLIENT, CAMERA.intrinsics))


@pytest.fixture(scope="module")
def truth() -> Splats:
    splats = open_scene("procedural:size=2000").frame(0)
    return replace(splats, sh_rest=splats.sh_rest[:, :0])


def drawn(splats: Splats, camera: Camera = CAMERA) -> RenderedView:
    return raster.create("auto").load(splats).render(camera, OPTIONS)


def tinted(splats: Splats, change: tuple[float, float, float]) -> Splats:
    return replace(splats, sh0=splats.sh0 + np.asarray(change, np.float32) / np.float32(SH_C0))


def reference_of(splats: Splats) -> ReferencePicture:
    return ReferencePicture(np.clip(drawn(splats).rgb, 0, 1), CAMERA, 0)


def steps(adapter: SirtAdapter, scene: RasterScene, held: Splats, reference: ReferencePicture, count: int) -> int:
    return sum(adapter.adapt(scene, held, reference, scene.render(CAMERA, OPTIONS), OPTIONS) for _ in range(count))


def test_a_cast_goes_and_stays_gone_from_another_pose(truth: Splats) -> None:
    held = tinted(truth, (0.1, -0.05, 0.08))
    scene, adapter = raster.create("auto").load(held), SirtAdapter(len(held))
    assert steps(adapter, scene, held, reference_of(truth), 6) > 0
    beside = CAMERA.at(Pose((0.15, 0.0, 0.0), (1, 0, 0, 0)))
    for camera, gain_db in ((CAMERA, 8.0), (beside, 5.0)):
        true = drawn(truth, camera).rgb
        before, after = psnr(drawn(held, camera).rgb, true), psnr(scene.render(camera, OPTIONS).rgb, true)
        assert after > before + gain_db


def test_splats_that_are_right_are_left_alone(truth: Splats) -> None:
    scene, adapter = raster.create("auto").load(truth), SirtAdapter(len(truth))
    assert steps(adapter, scene, truth, reference_of(truth), 1) == 0


def test_no_colour_goes_further_than_the_bound(truth: Splats) -> None:
    black = replace(truth, sh0=np.full_like(truth.sh0, -0.5 / SH_C0))
    white = tinted(truth, (2.0, 2.0, 2.0))
    scene, adapter = raster.create("auto").load(black), SirtAdapter(len(black))
    steps(adapter, scene, black, reference_of(white), 12)
    rows = np.arange(len(black))
    change = (adapter.corrected(black.sh0, rows) - black.sh0) * SH_C0
    assert 0.8 * MAX_CHANGE < np.abs(change).max() <= MAX_CHANGE * 1.0001


def test_what_changed_is_forgotten_and_the_rest_is_not(truth: Splats) -> None:
    held = tinted(truth, (0.1, 0.1, 0.1))
    scene, adapter = raster.create("auto").load(held), SirtAdapter(len(held))
    steps(adapter, scene, held, reference_of(truth), 3)
    rows = np.arange(len(held))
    moved = np.nonzero(np.abs(adapter.corrected(held.sh0, rows) - held.sh0).max(axis=1) > 0)[0]
    adapter.forget(moved[:10])
    after = np.abs(adapter.corrected(held.sh0, rows) - held.sh0).max(axis=1)
    assert (after[moved[:10]] == 0).all()
    assert (after[moved[10:]] > 0).all()


def test_a_black_reference_and_an_empty_view_stay_finite(truth: Splats) -> None:
    scene, adapter = raster.create("auto").load(truth), SirtAdapter(len(truth))
    black = ReferencePicture(np.zeros((60, 80, 3), np.float32), CAMERA, 0)
    steps(adapter, scene, truth, black, 2)
    assert np.isfinite(scene.render(CAMERA, OPTIONS).rgb).all()
    away = CAMERA.at(Pose((0.0, 0.0, 1e6), (1, 0, 0, 0)))
    own = scene.render(away, OPTIONS)
    assert adapter.adapt(scene, truth, replace(black, camera=away), own, OPTIONS) == 0
