"""Shortcuts of the native backend: what they keep, what they may give up, and what makes them look again."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import cags_kernels
from cags_common.geometry import Pose
from cags_common.raster import DepthKind, Footprint, RenderOptions, Shortcuts, create
from support.raster_scenes import F, assert_sound, camera, psnr_db, random_splats, splat, tilted_camera

pytestmark = pytest.mark.skipif(not cags_kernels.native_available(), reason=cags_kernels.why_unavailable())

EXACT_COLOURS = RenderOptions()


def keeping(degrees: float) -> RenderOptions:
    return RenderOptions(shortcuts=Shortcuts(colour_angle_rad=math.radians(degrees)))


def orbiting(degrees: float):
    angle = math.radians(degrees)
    eye = (5 * math.sin(angle), 0.0, -5 * math.cos(angle))
    return camera().at(Pose.looking_at(eye, (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)))


@pytest.fixture(scope="module")
def splats():
    return random_splats(3000, degree=3, seed=7)


def lone_splat_of_harmonics():
    return replace(splat(logit=3.0), sh_rest=np.random.default_rng(3).normal(size=(1, 15, 3)).astype(F))


def colour(scene, cam, options) -> np.ndarray:
    view = scene.render(cam, options)
    return view.rgb[view.alpha.argmax() // 96, view.alpha.argmax() % 96] / view.alpha.max()


def test_the_first_view_and_a_turn_of_the_camera_alone_are_exact(splats):
    scene, options = create("cpu").load(splats), keeping(1.0)
    np.testing.assert_array_equal(scene.render(orbiting(0), options).rgb, scene.render(orbiting(0), EXACT_COLOURS).rgb)
    turned = orbiting(0).at(Pose.looking_at((0.0, 0.0, -5.0), (0.5, 0.2, 0.0), (0.0, 1.0, 0.0)))
    np.testing.assert_array_equal(scene.render(turned, options).rgb, scene.render(turned, EXACT_COLOURS).rgb)


def test_a_colour_is_kept_within_the_angle_and_made_anew_beyond_it():
    scene, options = create("cpu").load(lone_splat_of_harmonics()), keeping(2.0)
    first = colour(scene, orbiting(0), options)
    np.testing.assert_allclose(colour(scene, orbiting(1.9), options), first, atol=1e-6)
    assert np.abs(colour(scene, orbiting(1.9), EXACT_COLOURS) - first).max() > 1e-3
    np.testing.assert_allclose(
        colour(scene, orbiting(2.1), options), colour(scene, orbiting(2.1), EXACT_COLOURS), atol=1e-6
    )
    opposite = orbiting(180.0)
    np.testing.assert_allclose(colour(scene, opposite, options), colour(scene, opposite, EXACT_COLOURS), atol=1e-6)


def test_kept_colours_stay_close_to_the_exact_ones(splats):
    scene, options = create("cpu").load(splats), keeping(1.0)
    for step in range(8):
        ours = scene.render(orbiting(0.4 * step), options)
        assert_sound(ours)
        assert psnr_db(ours.rgb, scene.render(orbiting(0.4 * step), EXACT_COLOURS).rgb) > 50


def test_updates_and_another_degree_make_colours_anew(splats):
    scene, options = create("cpu").load(splats), keeping(5.0)
    scene.render(orbiting(0), options)
    rows = np.arange(0, 2990, 7)
    fresh = random_splats(len(rows), degree=3, seed=9)
    scene.update(rows, fresh)
    np.testing.assert_array_equal(scene.render(orbiting(0), options).rgb, scene.render(orbiting(0), EXACT_COLOURS).rgb)
    scene.recolour(rows + 3, fresh.sh0)
    np.testing.assert_array_equal(scene.render(orbiting(0), options).rgb, scene.render(orbiting(0), EXACT_COLOURS).rgb)
    flat = replace(options, max_sh_degree=0)
    np.testing.assert_array_equal(
        scene.render(orbiting(0), flat).rgb, scene.render(orbiting(0), RenderOptions(max_sh_degree=0)).rgb
    )
    lower = replace(options, max_sh_degree=1)
    np.testing.assert_array_equal(
        scene.render(orbiting(0), lower).rgb, scene.render(orbiting(0), RenderOptions(max_sh_degree=1)).rgb
    )


def test_kept_colours_do_not_depend_on_the_number_of_threads(splats):
    views = []
    for threads in (1, 3):
        scene, options = create("cpu").load(splats), replace(keeping(1.0), threads=threads)
        views.append([scene.render(orbiting(0.4 * step), options).rgb for step in range(5)])
    np.testing.assert_array_equal(views[0], views[1])


@pytest.mark.parametrize("size", [(96, 64), (97, 63), (1, 1), (2, 3)])
@pytest.mark.parametrize("depth", DepthKind)
def test_half_resolution_is_sound_at_any_size(splats, size, depth):
    options = RenderOptions(depth=depth, contribution=True, shortcuts=Shortcuts(half_resolution=True))
    view = create("cpu").load(splats).render(tilted_camera(*size), options)
    assert view.rgb.shape == (size[1], size[0], 3)
    assert view.alpha.shape == (size[1], size[0])
    assert_sound(view)


def test_half_resolution_comes_close_to_the_whole_one_and_its_footprint_is_why():
    splats, cam = random_splats(400, seed=2, log_scale=-2.0), tilted_camera(192, 128)
    scene = create("cpu").load(splats)
    whole = scene.render(cam, RenderOptions(contribution=True))
    options = RenderOptions(contribution=True, shortcuts=Shortcuts(half_resolution=True))
    half = scene.render(cam, options)
    assert psnr_db(half.rgb, whole.rgb) > 38
    assert psnr_db(half.alpha, whole.alpha) > 35
    assert half.contribution.sum() == pytest.approx(whole.contribution.sum(), rel=0.02)
    wide = replace(options, footprint=Footprint(0.3 * 4))  # what a plain view of half the size would draw
    assert psnr_db(scene.render(cam, wide).rgb, whole.rgb) < psnr_db(half.rgb, whole.rgb) - 3


def test_half_resolution_depth_does_not_mix_two_surfaces():
    front = splat((-0.9, 0.0, 0.0), scale=(0.4, 2.0, 0.01), logit=9.0)
    back = splat((0.0, 0.0, 3.0), scale=(9.0, 9.0, 0.01), logit=9.0)
    both = replace(front, **{name: np.concatenate([a, getattr(back, name)]) for name, a in front.arrays()})
    scene, cam = create("cpu").load(both), camera(96, 64)
    options = RenderOptions(depth=DepthKind.MEDIAN)
    whole = scene.render(cam, options).depth
    half = scene.render(cam, replace(options, shortcuts=Shortcuts(half_resolution=True))).depth
    assert set(np.unique(np.round(half[np.isfinite(half)]))) == set(np.unique(np.round(whole[np.isfinite(whole)])))
    assert (np.isclose(half, whole, rtol=1e-3) | (np.isinf(half) & np.isinf(whole))).mean() > 0.95


def test_a_constant_picture_stays_constant_and_its_edges_stay_in_range():
    scene = create("cpu").load(splat(scale=(50.0, 50.0, 50.0), logit=20.0))
    view = scene.render(camera(), RenderOptions(shortcuts=Shortcuts(half_resolution=True)))
    whole = scene.render(camera(), RenderOptions())
    np.testing.assert_allclose(view.rgb, whole.rgb, atol=1e-4)
    np.testing.assert_allclose(view.alpha, whole.alpha, atol=1e-4)


def test_half_resolution_is_refused_for_residuals(splats):
    options = RenderOptions(shortcuts=Shortcuts(half_resolution=True))
    with pytest.raises(ValueError, match="half_resolution"):
        create("cpu").load(splats).back_project(camera(), np.zeros((64, 96, 3), F), options)


@pytest.mark.parametrize("angle", [-0.1, 0.6, math.nan])
def test_angles_out_of_range_are_refused(angle):
    with pytest.raises(ValueError, match="colour_angle_rad"):
        Shortcuts(colour_angle_rad=angle)
