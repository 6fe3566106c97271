"""The reference backend against closed forms: it defines what is right, so it is checked against mathematics."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import sph_harm_y

from cags_common.raster import DepthKind, Footprint, RenderOptions, create
from cags_common.raster.definition import ALPHA_CUT, ALPHA_MAX, content_hash
from cags_common.raster.harmonics import harmonics
from cags_common.splats import SH_C0, Splats
from support.raster_scenes import camera, random_splats, splat, tilted_camera

REFERENCE = create("oracle")
F = np.float32


def centred_camera():
    """Odd sizes: the principal point is a pixel's centre."""
    return camera(33, 33)


def test_a_lone_splat_shows_its_colour_times_its_opacity_at_its_centre():
    view = REFERENCE.load(splat(logit=0.0, sh0=(1.0, 0.5, 0.0))).render(centred_camera(), RenderOptions())
    assert view.alpha[16, 16] == pytest.approx(0.5, abs=1e-6)
    np.testing.assert_allclose(view.rgb[16, 16], 0.5 * (0.5 + SH_C0 * np.array([1.0, 0.5, 0.0])), atol=1e-6)
    assert view.depth[16, 16] == pytest.approx(5.0)


def test_alpha_falls_off_as_the_projected_gaussian():
    scale, distance, offset = 0.3, 5.0, 4
    cam = centred_camera()
    view = REFERENCE.load(splat(scale=(scale,) * 3)).render(cam, RenderOptions())
    variance = (cam.intrinsics.fx_px * scale / distance) ** 2 + 0.3
    assert view.alpha[16, 16 + offset] == pytest.approx(0.5 * np.exp(-0.5 * offset**2 / variance), rel=1e-5)


def test_alpha_is_capped_and_cut():
    view = REFERENCE.load(splat(logit=20.0, scale=(0.3,) * 3)).render(centred_camera(), RenderOptions())
    assert view.alpha.max() == pytest.approx(ALPHA_MAX)
    drawn = view.alpha[view.alpha > 0]
    assert drawn.min() >= ALPHA_CUT - 1e-7


def test_two_splats_composite_front_to_back():
    back, front = splat((0, 0, 1.0), sh0=(2, 0, 0)), splat((0, 0, -1.0), sh0=(0, 0, 2))
    view = REFERENCE.load(Splats.concatenate([back, front])).render(centred_camera(), RenderOptions())
    bright, dark = 0.5 + 2 * SH_C0, 0.5
    np.testing.assert_allclose(
        view.rgb[16, 16], [0.5 * dark + 0.25 * bright, 0.75 * 0.5, 0.5 * bright + 0.25 * dark], atol=1e-6
    )
    assert view.depth[16, 16] == pytest.approx((0.5 * 4 + 0.25 * 6) / 0.75)


def test_void_pixels_have_infinite_depth_and_none_can_be_asked_for():
    scene = REFERENCE.load(splat())
    view = scene.render(centred_camera(), RenderOptions(void_alpha=0.2))
    assert np.isinf(view.depth[view.alpha < 0.2]).all()
    assert np.isfinite(view.depth[view.alpha >= 0.2]).all()
    assert scene.render(centred_camera(), RenderOptions(depth=DepthKind.NONE)).depth is None


def test_the_filter_keeps_a_splats_weight_where_dilation_adds_to_it():
    small = splat(scale=(0.06,) * 3, logit=1.0)
    weights = {}
    for name, footprint in {
        "plain": Footprint(1e-4),
        "filtered": Footprint(1e-4, 1.0),
        "dilated": Footprint(1.0),
    }.items():
        view = REFERENCE.load(small).render(camera(65, 65), RenderOptions(footprint=footprint, contribution=True))
        weights[name] = float(view.contribution[0])
    expected = 2 * np.pi * (camera(65, 65).intrinsics.fx_px * 0.06 / 5) ** 2 / (1 + np.exp(-1.0))
    assert weights["filtered"] == pytest.approx(expected, rel=0.15)  # less what the cut takes off its rim
    assert weights["plain"] == pytest.approx(expected, rel=0.05)
    assert weights["dilated"] > 2 * weights["filtered"]


def test_the_clients_footprint_is_the_mean_of_the_clients_pixels():
    splats = random_splats(300, log_scale=-3.5)
    client, reference = camera(192, 128), camera(48, 32)
    scene = REFERENCE.load(splats)
    fine = scene.render(client, RenderOptions()).rgb.reshape(32, 4, 48, 4, 3).mean(axis=(1, 3))
    errors = {}
    for name, footprint in {
        "of": Footprint.of(client.intrinsics, reference.intrinsics),
        "classic": Footprint.classic(),
    }.items():
        errors[name] = float(np.mean((scene.render(reference, RenderOptions(footprint=footprint)).rgb - fine) ** 2))
    assert errors["of"] < 0.2 * errors["classic"]


def test_harmonics_match_the_standard_real_ones():
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    theta, phi = np.arccos(directions[:, 2]), np.arctan2(directions[:, 1], directions[:, 0])
    ours = harmonics(directions, 15)
    index = 0
    for degree in (1, 2, 3):
        for order in range(-degree, degree + 1):
            y = sph_harm_y(degree, abs(order), theta, phi)
            real = y.real if order == 0 else np.sqrt(2) * (y.imag if order < 0 else y.real)  # keeps scipy's (-1)^m
            np.testing.assert_allclose(ours[:, index], real, atol=1e-12)
            index += 1


def test_contributions_sum_to_alpha():
    view = REFERENCE.load(random_splats(400)).render(tilted_camera(), RenderOptions(contribution=True))
    assert view.contribution.sum() == pytest.approx(view.alpha.sum(), rel=1e-5)


def test_the_content_hash_is_of_the_content_alone():
    splats = random_splats(100, degree=1)
    order = np.random.default_rng(0).permutation(100)
    np.testing.assert_array_equal(content_hash(splats)[order], content_hash(splats.take(order)))
    assert len(np.unique(content_hash(splats))) == 100
