"""The native backend against the reference, and the promises of its own: threads, updates, concurrency."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import cags_kernels
from cags_common.errors import ConfigError, SceneError
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.raster import DepthKind, Exactness, Footprint, RenderOptions, create
from cags_common.splats import Splats
from support.raster_scenes import assert_sound, camera, changed, psnr_db, random_splats, splat, tilted_camera

pytestmark = pytest.mark.skipif(not cags_kernels.native_available(), reason=cags_kernels.why_unavailable())

F = np.float32
LEAST_DB = {Exactness.FAST: 60.0, Exactness.BALANCED: 75.0, Exactness.EXACT: 100.0}
FOOTPRINTS = {"classic": Footprint.classic(), "filtered": Footprint(0.0, 0.3), "client": Footprint(0.02, 1 / 12)}


@pytest.fixture(scope="module")
def splats() -> Splats:
    return random_splats(3000, degree=3, seed=7)


@pytest.fixture(scope="module")
def scenes(splats):
    return create("oracle").load(splats), create("cpu").load(splats)


@pytest.fixture(params=["portable", "avx2", "avx512"])
def instruction_set(request):
    before = cags_kernels.instruction_set()
    try:
        cags_kernels.use_instruction_set(request.param)
    except cags_kernels.KernelError:
        pytest.skip(f"this processor does not run {request.param}")
    yield request.param
    cags_kernels.use_instruction_set(before)


@pytest.mark.parametrize("exactness", Exactness)
@pytest.mark.parametrize("footprint", FOOTPRINTS.values(), ids=FOOTPRINTS)
def test_colour_and_alpha_match_the_reference(scenes, instruction_set, exactness, footprint):
    options = RenderOptions(footprint=footprint, exactness=exactness)
    right, ours = (scene.render(tilted_camera(), options) for scene in scenes)
    assert_sound(ours)
    assert psnr_db(right.rgb, ours.rgb) > LEAST_DB[exactness]
    assert psnr_db(right.alpha, ours.alpha) > LEAST_DB[exactness] - 6


def test_depth_matches_the_reference(scenes, instruction_set):
    options = RenderOptions(exactness=Exactness.EXACT)
    right, ours = (scene.render(tilted_camera(), options).depth for scene in scenes)
    same = np.isclose(right, ours, rtol=1e-5) | (np.isinf(right) & np.isinf(ours))
    assert same.mean() > 0.999  # a pixel at the very threshold may fall on either side


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_every_sh_degree_matches_the_reference(scenes, degree):
    options = RenderOptions(exactness=Exactness.EXACT, max_sh_degree=degree)
    right, ours = (scene.render(tilted_camera(), options) for scene in scenes)
    assert psnr_db(right.rgb, ours.rgb) > 100


def test_contributions_match_the_reference(scenes, instruction_set):
    options = RenderOptions(exactness=Exactness.EXACT, contribution=True)
    right, ours = (scene.render(tilted_camera(), options).contribution for scene in scenes)
    np.testing.assert_allclose(ours, right, atol=5e-3, rtol=1e-5)


def test_results_do_not_depend_on_the_number_of_threads(splats):
    scene, cam = create("cpu").load(splats), camera(301, 203)
    views = [scene.render(cam, RenderOptions(threads=n, contribution=True)) for n in (1, 2, 5)]
    for view in views[1:]:
        for name in ("rgb", "alpha", "depth", "contribution"):
            np.testing.assert_array_equal(getattr(view, name), getattr(views[0], name))


def test_renders_beside_each_other_are_right(splats):
    scene = create("cpu").load(splats)
    cameras = [camera(160 + 16 * i, 120) for i in range(6)]
    alone = [scene.render(cam, RenderOptions(threads=1)).rgb for cam in cameras]
    with ThreadPoolExecutor(6) as pool:
        for _ in range(5):
            beside = pool.map(lambda cam: scene.render(cam, RenderOptions(threads=2)).rgb, cameras)
            for a, b in zip(alone, beside, strict=True):
                np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("backend", ["oracle", "cpu"])
def test_an_update_equals_a_fresh_load(splats, backend):
    rng = np.random.default_rng(5)
    rows = rng.choice(len(splats), 200, replace=False)
    new = changed(splats, rows, random_splats(200, degree=3, seed=9))
    updated, cam = create(backend).load(splats), tilted_camera(48, 32)
    updated.update(rows, new, threads=2)
    loaded = create(backend).load(new)
    options = RenderOptions(contribution=True)
    for name in ("rgb", "alpha", "depth", "contribution"):
        np.testing.assert_array_equal(
            getattr(updated.render(cam, options), name), getattr(loaded.render(cam, options), name)
        )


@pytest.mark.parametrize("backend", ["oracle", "cpu"])
def test_updates_that_do_not_fit_are_refused(backend):
    scene = create(backend).load(random_splats(10, degree=0))
    with pytest.raises(ValueError, match="degree 3 for a scene with 0 harmonics"):
        scene.update(np.arange(2), random_splats(10, degree=3))
    with pytest.raises(IndexError, match="rows"):
        scene.update(np.array([3, 10]), random_splats(10))
    with pytest.raises(ValueError, match="2 splats for a scene of 10"):
        scene.update(np.arange(2), random_splats(2))
    bad = random_splats(10)
    bad.means[1, 2] = np.nan
    with pytest.raises(SceneError, match=r"means\[1\]"):
        scene.update(np.arange(2), bad)


def test_images_are_fresh_arrays_that_later_frames_do_not_touch(splats):
    scene = create("cpu").load(splats)
    first = scene.render(camera(), RenderOptions())
    kept, row = first.rgb.copy(), first.rgb[10]
    for _ in range(4):
        scene.render(tilted_camera(), RenderOptions())
    np.testing.assert_array_equal(first.rgb, kept)
    del first
    for _ in range(4):
        scene.render(tilted_camera(), RenderOptions())
    np.testing.assert_array_equal(row, kept[10])


def test_the_camera_is_checked():
    scene = create("cpu").load(splat())
    with pytest.raises(ConfigError, match="near"):
        scene.render(camera(near=0.0), RenderOptions())
    with pytest.raises(ConfigError, match="too large"):
        scene.render(camera(20000, 10), RenderOptions())


@pytest.mark.parametrize("backend", ["oracle", "cpu"])
def test_a_displayed_picture_ends_at_white_and_is_else_the_same(backend, instruction_set):
    splats = random_splats(60, seed=4)
    bright = create(backend).load(replace(splats, sh0=splats.sh0 + F(4)))
    plain, shown = (bright.render(tilted_camera(), RenderOptions(displayed=displayed)) for displayed in (False, True))
    assert plain.rgb.max() > 1.2
    np.testing.assert_array_equal(shown.rgb, np.minimum(plain.rgb, 1))
    np.testing.assert_array_equal(shown.alpha, plain.alpha)


@pytest.mark.parametrize("depth", DepthKind)
def test_a_large_picture_is_the_same_written_past_the_caches(instruction_set, depth):
    """Rows of whole cache lines are; with eight pixels more in each, the same view is not."""
    narrow, wide = (Camera(Intrinsics(width, 520, 700.0, 700.0, 400.0, 260.0), Pose.identity()) for width in (800, 808))
    scene = create("cpu").load(replace(random_splats(400, seed=5), means=_in_front(400)))
    ours, there = (scene.render(camera, RenderOptions(depth=depth, threads=2)) for camera in (narrow, wide))
    np.testing.assert_array_equal(ours.rgb, there.rgb[:, :800])
    np.testing.assert_array_equal(ours.alpha, there.alpha[:, :800])
    if depth is not DepthKind.NONE:
        assert ours.depth is not None and there.depth is not None
        np.testing.assert_array_equal(ours.depth, there.depth[:, :800])


def _in_front(count: int) -> NDArray[np.float32]:
    """Means well inside of a view from the origin along z, where no width's limits on the projection reach."""
    return np.random.default_rng(6).uniform((-1, -0.7, 4), (1, 0.7, 6), (count, 3)).astype(F)
