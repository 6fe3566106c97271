"""The ``gpu`` backend keeps the rasteriser seam's promises: partial updates, capacity, limits, options, determinism."""

from __future__ import annotations

import logging
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from cags_common.errors import SceneError
from cags_common.geometry import Camera, Pose
from cags_common.raster import DepthKind, Exactness, Footprint, RenderedView, RenderOptions, create
from cags_gpu.device import LEAST_BINDING_BYTES
from cags_gpu.graph import buffer_bytes
from cags_gpu.keeper import Keeper
from cags_gpu.raster import GpuRasteriser, GpuScene
from cags_gpu.scene import ResidentScene
from cags_gpu.submission import Output, Outputs, Recording, submitted
from cags_gpu.workspace import LEAST_CAPACITY
from support.gpu import any_gpu, keeper, needs_adapter, rasteriser
from support.raster_scenes import F, camera, changed, psnr_db, random_splats, splat, tilted_camera

pytestmark = needs_adapter

EXACT = RenderOptions(exactness=Exactness.EXACT, contribution=True)


def assert_same(a: RenderedView, b: RenderedView) -> None:
    for name in ("rgb", "alpha", "depth", "contribution"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


@pytest.mark.parametrize("degree", [0, 2, 3])
def test_an_updated_scene_draws_as_one_loaded_so(degree: int) -> None:
    splats, rows = random_splats(3000, degree=degree), np.arange(7, 3000, 11)
    new = random_splats(len(rows), degree=degree, seed=5)
    scene = rasteriser().load(splats)
    scene.render(tilted_camera(), EXACT)
    scene.update(rows, changed(splats, rows, new))
    loaded = rasteriser().load(changed(splats, rows, new))
    assert_same(scene.render(tilted_camera(), EXACT), loaded.render(tilted_camera(), EXACT))


def test_moved_scenes_draw_as_loaded_ones() -> None:
    splats, rows = random_splats(2000, degree=1), np.arange(0, 2000, 3)
    other = random_splats(2000, seed=8)
    placed = {name: getattr(other, name)[rows] for name in ("means", "quats", "logit_opacities")}
    moved = changed(splats, rows, replace(splats.take(rows), **placed))
    scene = rasteriser().load(splats)
    scene.render(camera(), EXACT)
    scene.move(rows, moved)
    assert_same(scene.render(camera(), EXACT), rasteriser().load(moved).render(camera(), EXACT))


def test_rows_in_any_order_and_twice_are_updated_once() -> None:
    splats, new = random_splats(50), random_splats(50, seed=9)
    scene = rasteriser().load(splats)
    scene.update(np.array([8, 4, 8]), new)
    right = changed(splats, np.array([4, 8]), new.take(np.array([4, 8])))
    assert_same(scene.render(camera(), EXACT), rasteriser().load(right).render(camera(), EXACT))


def test_what_cannot_be_drawn_is_refused_and_changes_nothing() -> None:
    scene = rasteriser().load(random_splats(20))
    before = scene.render(camera(), EXACT)
    moved = random_splats(20, seed=4)
    with pytest.raises(IndexError, match=r"rows 20\.\.20"):
        scene.move(np.array([20]), moved)
    with pytest.raises(ValueError, match="19 splats for a scene of 20"):
        scene.move(np.array([1, 2]), moved.take(slice(0, 19)))
    moved.means[3] = np.nan
    with pytest.raises(SceneError, match="not finite"):
        scene.move(np.array([3]), moved)
    moved.quats[5] = 0
    with pytest.raises(SceneError, match="no direction"):
        scene.move(np.array([5]), moved)
    with pytest.raises(SceneError, match="not finite"):
        scene.update(np.array([1]), replace(random_splats(20), means=np.full((20, 3), np.inf, F)))
    assert_same(scene.render(camera(), EXACT), before)


def test_the_order_of_the_rows_does_not_show() -> None:
    splats = random_splats(4000, degree=1)
    splats.means[:, 2] = 0.25  # one depth: ties everywhere
    order = np.random.default_rng(0).permutation(len(splats))
    views = [rasteriser().load(s).render(camera(), EXACT) for s in (splats, splats.take(order))]
    np.testing.assert_array_equal(views[0].rgb, views[1].rgb)
    np.testing.assert_array_equal(views[0].contribution[order], views[1].contribution)


def test_two_frames_have_the_same_bytes() -> None:
    scene = rasteriser().load(random_splats(5000, degree=3))
    first = scene.render(tilted_camera(), EXACT)
    scene.render(camera(33, 37), EXACT)
    assert_same(scene.render(tilted_camera(), EXACT), first)


@pytest.mark.parametrize("footprint", [Footprint.classic(), Footprint(0.0, 0.3), Footprint(0.02, 1 / 12)])
def test_depth_alpha_and_contribution_are_the_definitions(footprint: Footprint) -> None:
    splats, options = random_splats(3000, degree=2), replace(EXACT, footprint=footprint)
    right = create("oracle").load(splats).render(tilted_camera(), options)
    ours = rasteriser().load(splats).render(tilted_camera(), options)
    assert psnr_db(ours.rgb, right.rgb) > 120, "no pixel at a splat's rim falls on the other side of the cut"
    assert psnr_db(ours.alpha, right.alpha) > 120
    np.testing.assert_allclose(ours.contribution, right.contribution, rtol=1e-4, atol=2e-3)
    both = np.isfinite(ours.depth) & np.isfinite(right.depth)
    assert (np.isfinite(ours.depth) != np.isfinite(right.depth)).sum() <= 2
    assert np.quantile(np.abs(ours.depth[both] / right.depth[both] - 1), 0.995) < 1e-4


def test_options_leave_out_what_they_say() -> None:
    splats = random_splats(800, degree=2, log_scale=-1.0)
    splats.sh0[:] += 3
    scene = rasteriser().load(splats)
    plain = scene.render(camera(), RenderOptions(depth=DepthKind.NONE))
    assert plain.depth is None
    assert plain.contribution is None
    assert plain.rgb.max() > 1
    shown = scene.render(camera(), replace(EXACT, displayed=True)).rgb
    assert shown.max() == 1
    right = create("oracle").load(splats).render(camera(), replace(EXACT, displayed=True)).rgb
    assert psnr_db(shown, right) > 100, "splats brighter than white are not cut off before they are blended"
    flat = rasteriser().load(replace(splats, sh_rest=np.zeros_like(splats.sh_rest))).render(camera(), EXACT)
    np.testing.assert_allclose(scene.render(camera(), replace(EXACT, max_sh_degree=0)).rgb, flat.rgb, atol=1e-6)


def test_an_empty_scene_is_black_and_void_and_one_splat_is_drawn() -> None:
    empty = rasteriser().load(random_splats(0))
    view = empty.render(camera(), EXACT)
    assert len(empty) == 0
    assert not view.rgb.any()
    assert np.isinf(view.depth).all()
    assert view.contribution.shape == (0,)
    assert rasteriser().load(splat()).render(camera(), EXACT).rgb.max() > 0.1


def test_infinity_is_written_where_a_pixel_is_void() -> None:
    view = rasteriser().load(splat()).render(camera(), EXACT)
    assert view.depth.view(np.uint32)[0, 0] == 0x7F800000
    assert not np.isnan(view.depth).any()


def test_entries_that_overflow_are_drawn_again_and_nothing_wrong_shows() -> None:
    own = Keeper(any_gpu)
    workspace = own.current()
    splats, wide = random_splats(1500, log_scale=-0.3), camera(200, 150)
    splats.logit_opacities[:] -= 2
    scene = GpuRasteriser(own).load(splats)
    first = scene.render(wide, EXACT)
    assert workspace.counts["capacity"] > LEAST_CAPACITY
    assert_same(first, scene.render(wide, EXACT))
    assert psnr_db(first.rgb, create("oracle").load(splats).render(wide, EXACT).rgb) > 100
    own.close()


def test_harmonics_beyond_a_binding_are_split() -> None:
    splats = random_splats(2000, degree=3)
    whole = rasteriser().load(splats).render(camera(), EXACT)
    own = Keeper(any_gpu)
    own.current().gpu.max_binding_bytes = 100_000  # 555 splats' harmonics, all else whole
    own.current().counts["capacity"] = 1 << 14
    scene = GpuRasteriser(own).load(splats)
    parts = scene.render(camera(), EXACT)
    assert scene._resident is not None, "the device drew it"
    assert len(scene._resident._chunks) > 3
    assert_same(whole, parts)
    new = changed(splats, np.arange(0, 2000, 5), splats.take(np.arange(1, 2000, 5)))
    scene.update(np.arange(0, 2000, 5), new)
    again = rasteriser().load(new)
    assert_same(scene.render(camera(), EXACT), again.render(camera(), EXACT))
    own.close()


def test_what_no_buffer_holds_is_drawn_by_the_cpu_and_said_once(caplog: pytest.LogCaptureFixture) -> None:
    own = Keeper(any_gpu)
    own.current().gpu.max_binding_bytes = 4096
    scene = GpuRasteriser(own).load(random_splats(500))
    with caplog.at_level(logging.WARNING):
        views = [scene.render(camera(), EXACT) for _ in range(2)]
    told = [r.message for r in caplog.records if "the CPU draws this scene" in r.message]
    assert len(told) == 1
    assert "500 splats" in told[0]
    right = create("cpu").load(random_splats(500)).render(camera(), EXACT)
    np.testing.assert_array_equal(views[1].rgb, right.rgb)
    own.close()


def test_four_million_splats_fit_every_device() -> None:
    """Whatever a frame of a client or a server binds stays within WebGPU's least limit; harmonics are split."""
    counts = {"splats": 4_000_000, "exact_splats": 4_000_000, "capacity": 16_000_000, "one": 1}
    sizes = buffer_bytes("scene", counts) | buffer_bytes("work", counts)
    too_large = {name for name, size in sizes.items() if size > LEAST_BINDING_BYTES}
    assert not too_large


@pytest.mark.slow
def test_four_million_splats_are_drawn_as_by_the_cpu() -> None:
    splats, view = random_splats(4_000_000, seed=3, log_scale=-5.0), camera(96, 64)
    ours = rasteriser().load(splats).render(view, EXACT)
    assert psnr_db(ours.rgb, create("cpu").load(splats).render(view, EXACT).rgb) > 100


def test_scenes_share_working_memory_and_do_not_disturb_each_other() -> None:
    scenes: list[GpuScene] = [rasteriser().load(random_splats(n, seed=n)) for n in (50, 4000, 300)]
    alone = [scene.render(camera(), EXACT) for scene in scenes]
    for scene, view in zip(reversed(scenes), reversed(alone), strict=True):
        assert_same(scene.render(camera(), EXACT), view)


def test_the_device_of_the_tests_is_named() -> None:
    info = keeper().current().gpu.info
    assert info.name
    assert info.backend in str(info)


def test_the_depth_that_orders_is_the_definitions_to_the_last_bit() -> None:
    splats = random_splats(20_000, seed=21)
    splats.means[:5000] *= F(1e-3)
    splats.means[5000:9000] += np.array([0, 0, 3e4], F)
    splats.means[9000:9500, :2] = 0
    for cam in (tilted_camera(), camera(), tilted_camera().at(Pose((1e3, 2e3, -4e4), (0.9, 0.1, -0.2, 0.3)))):
        scene = rasteriser().load(splats)
        seen, depths = scene.on_device(partial(_ordering_depths, camera=cam), lambda _: None)
        offsets = splats.means.astype(np.float64) - np.asarray(cam.pose.position)
        right = (offsets @ cam.world_to_camera[0].T)[:, 2].astype(F)
        assert (depths[seen] == right[seen]).mean() > 0.9999
        np.testing.assert_allclose(depths[seen], right[seen], rtol=1.2e-7)


def _ordering_depths(scene: ResidentScene, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Which splats are drawn, and the depth of each."""

    def record(recording: Recording) -> Outputs:
        scene.record_binning(recording, camera, EXACT)
        sizes = {"touched": 4 * scene.count, "records": 32 * scene.count}
        return [Output(scene.workspace[name], size) for name, size in sizes.items()]

    touched, records = submitted(scene.workspace, record)
    return touched.view(np.uint32) > 0, records.view(F).reshape(-1, 8)[:, 5]


def test_frames_may_be_drawn_from_several_threads() -> None:
    scenes = [rasteriser().load(random_splats(400, seed=seed)) for seed in range(3)]
    right = [scene.render(camera(), EXACT) for scene in scenes]
    with ThreadPoolExecutor(4) as pool:
        views = list(pool.map(lambda i: scenes[i % 3].render(camera(), EXACT), range(12)))
    for i, view in enumerate(views):
        assert_same(view, right[i % 3])
