"""Hard cases against the reference, in every level of exactness: finite, alpha in [0, 1], within the level's bound."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import cags_kernels
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.raster import DepthKind, Exactness, Footprint, RenderOptions, Shortcuts, create
from cags_common.raster.cpu import BOUNDS
from cags_common.splats import Splats
from support.raster_scenes import F, assert_sound, camera, random_splats, splat, tilted_camera

pytestmark = pytest.mark.skipif(not cags_kernels.native_available(), reason=cags_kernels.why_unavailable())

RNG_SEED = 11
FOOTPRINTS = {"antialiased": Footprint.antialiased(), "client": Footprint(0.3 / 36, 1 / 12)}


def cloud(**columns: np.ndarray) -> Splats:
    """A random cloud with some columns replaced."""
    count = len(next(iter(columns.values())))
    return replace(random_splats(count, seed=RNG_SEED), **{name: np.asarray(c, F) for name, c in columns.items()})


def around_the_near_plane() -> Splats:
    splats = random_splats(400, seed=1, log_scale=-1.5)
    splats.means[:, 2] = np.linspace(-5.4, -4.6, 400)  # the near plane lies at -4.8
    return splats


def at_the_near_plane() -> Splats:
    splats = random_splats(50, seed=2)
    splats.means[:] = (0, 0, -4.8)
    splats.means[:, 2] += np.float32(1e-7) * np.arange(-25, 25)
    return splats


def around_the_camera() -> Splats:
    splats = random_splats(500, seed=3, log_scale=0.0)
    splats.means[:] = splats.means * 0.5 + np.array([0, 0, -5], F)
    return splats


def needles() -> Splats:
    splats = random_splats(300, seed=4)
    splats.log_scales[:] = np.log([1.0, 1e-5, 1e-5])
    return splats


def long_needles() -> Splats:
    splats = random_splats(40, seed=5)
    splats.log_scales[:] = np.log([1e3, 1e-2, 1e-2])
    return splats


def discs_edge_on() -> Splats:
    """Covariance singular in the view: flat discs that contain the view direction."""
    splats = random_splats(200, seed=6)
    splats.quats[:] = (1, 0, 0, 0)
    splats.log_scales[:] = np.log([1e-12, 0.3, 0.3])
    return splats


def extreme_scales(scale: float) -> Callable[[], Splats]:
    return lambda: cloud(log_scales=np.full((100, 3), math.log(scale)))


def mixed_scales() -> Splats:
    exponents = np.random.default_rng(7).uniform(math.log(1e-12), math.log(1e6), size=(300, 3))
    return cloud(log_scales=exponents)


def overflowing() -> Splats:
    """Finite values whose exponentials and squares are not."""
    splats = random_splats(64, seed=8)
    splats.log_scales[:16] = 3e38
    splats.log_scales[16:24] = -3e38
    splats.means[24:32] = 3e38
    splats.means[32:40] *= F(1e18)
    splats.logit_opacities[40:48] = 3e38
    splats.logit_opacities[48:56] = -3e38
    splats.sh0[56:60] = -3e38
    return splats


def denormal() -> Splats:
    tiny = np.float32(1e-42)
    splats = random_splats(60, seed=9, degree=1)
    splats.means[:20] = tiny
    splats.quats[20:30] *= F(1e-11)
    splats.log_scales[30:40] = tiny
    splats.logit_opacities[40:50] = tiny
    splats.sh0[50:55] = tiny
    splats.sh_rest[55:] = tiny
    return splats


def zeros() -> Splats:
    n = 20
    quats = np.tile(np.array([[1, 0, 0, 0]], F), (n, 1))
    shapes = {"means": (n, 3), "log_scales": (n, 3), "logit_opacities": (n,), "sh0": (n, 3), "sh_rest": (n, 8, 3)}
    return Splats(quats=quats, **{name: np.zeros(shape, F) for name, shape in shapes.items()})


def opacities_of_zero_and_one() -> Splats:
    logits = np.tile(np.array([-np.inf, np.inf, -20, 20, 100, -100, -5.5413, -5.5412], F), 50)
    return cloud(logit_opacities=logits)


def one_depth() -> Splats:
    splats = random_splats(5000, seed=10)
    splats.means[:, 2] = 0.25
    return splats


def one_position() -> Splats:
    splats = random_splats(3000, seed=12, log_scale=-1.5)
    splats.means[:] = (0.1, -0.2, 0.3)
    splats.logit_opacities[:] = -4
    return splats


def identical() -> Splats:
    return splat(scale=(0.3, 0.2, 0.1), logit=-3.0).take(np.zeros(2000, np.int64))


def crowded_tile() -> Splats:
    """More than 2^16 splats in one tile."""
    splats = random_splats(70_000, seed=13, spread=0.02, log_scale=-6.0)
    splats.logit_opacities[:] -= 3
    return splats


def far_from_the_origin() -> Splats:
    splats = random_splats(500, seed=14)
    splats.means[:] += np.array([1e6, -1e6, 1e6], F)
    return splats


FAR_CAMERA = camera().at(Pose((1e6, -1e6, 1e6 - 5), (1.0, 0.0, 0.0, 0.0)))
DEFAULT = camera()


def narrow_camera() -> Camera:
    return camera(64, 64, fov_rad=math.radians(1.0), distance=100.0)


def wide_camera() -> Camera:
    fov = math.radians(179.0)
    return Camera(Intrinsics.of_fov(64, 64, fov, fov), Pose((0.0, 0.0, -2.0), (1.0, 0.0, 0.0, 0.0)))


CASES: dict[str, tuple[Callable[[], Splats], Camera]] = {
    "around the near plane": (around_the_near_plane, DEFAULT),
    "at the near plane": (at_the_near_plane, DEFAULT),
    "around the camera": (around_the_camera, DEFAULT),
    "scales 1e-12": (extreme_scales(1e-12), DEFAULT),
    "scales 1e6": (extreme_scales(1e6), DEFAULT),
    "scales 1e-12 to 1e6": (mixed_scales, DEFAULT),
    "needles 1:1e5": (needles, tilted_camera()),
    "needles through the whole view": (long_needles, tilted_camera()),
    "singular in the view": (discs_edge_on, DEFAULT),
    "overflowing": (overflowing, DEFAULT),
    "denormal": (denormal, DEFAULT),
    "zeros": (zeros, DEFAULT),
    "opacities 0 and 1": (opacities_of_zero_and_one, DEFAULT),
    "one depth": (one_depth, DEFAULT),
    "one depth, camera tilted": (one_depth, tilted_camera()),
    "one position": (one_position, tilted_camera()),
    "identical": (identical, tilted_camera()),
    "2^16 in one tile": (crowded_tile, camera(64, 48)),
    "far from the origin": (far_from_the_origin, FAR_CAMERA),
    "empty": (lambda: random_splats(0), DEFAULT),
    "one splat": (splat, DEFAULT),
    "one pixel": (lambda: random_splats(300), camera(1, 1)),
    "one row": (lambda: random_splats(300), camera(131, 1)),
    "odd size": (lambda: random_splats(300), camera(33, 37)),
    "a size over the tile's by one": (lambda: random_splats(300), camera(65, 97)),
    "field of view 1 degree": (lambda: random_splats(300), narrow_camera()),
    "field of view 179 degrees": (lambda: random_splats(300, spread=3.0), wide_camera()),
}

USUAL_OF_SINGLE_PRECISION = {"scales 1e-12 to 1e6": 1e-3}
"""Needles of 1 : 1e18 with centres thousands of pixels away: float32 does not hold their direction any better."""

_rendered: dict[str, tuple[object, object]] = {}


def rendered(name: str) -> tuple[object, object]:
    """The case's reference view and the native scene, made once."""
    if name not in _rendered:
        make, cam = CASES[name]
        splats = make()
        options = RenderOptions(contribution=True)
        _rendered[name] = create("reference").load(splats).render(cam, options), create("cpu").load(splats)
    return _rendered[name]


@pytest.mark.parametrize("exactness", Exactness)
@pytest.mark.parametrize("name", CASES)
def test_is_sound_and_within_the_bound_of_its_level(name: str, exactness: Exactness):
    right, scene = rendered(name)
    ours = scene.render(CASES[name][1], RenderOptions(exactness=exactness, contribution=True))
    assert_sound(ours)
    bound = BOUNDS[exactness]
    scale = max(1.0, float(right.rgb.max()))
    error = np.abs(ours.rgb - right.rgb) / scale
    usual = max(bound.usual, USUAL_OF_SINGLE_PRECISION.get(name, 0.0))
    assert np.quantile(error.max(axis=2), 0.99, method="lower") <= usual
    assert error.max() <= bound.largest
    assert np.abs(ours.alpha - right.alpha).max() <= bound.largest


@pytest.mark.parametrize("exactness", Exactness)
@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize(
    "footprint", [Footprint.antialiased(), Footprint(0.3 / 36, 1 / 12)], ids=["antialiased", "client"]
)
def test_other_footprints_and_median_depth_and_back_projection_are_sound(name, footprint, exactness):
    _, scene = rendered(name)
    cam = CASES[name][1]
    options = RenderOptions(footprint=footprint, exactness=exactness, depth=DepthKind.MEDIAN, contribution=True)
    assert_sound(scene.render(cam, options))
    back = scene.back_project(cam, np.ones((cam.height_px, cam.width_px, 3), F), options)
    assert np.isfinite(back.weighted_residual).all()
    assert (back.weight >= 0).all()


@pytest.mark.parametrize("exactness", Exactness)
@pytest.mark.parametrize("name", CASES)
def test_shortcuts_are_sound(name, exactness):
    _, scene = rendered(name)
    shortcuts = Shortcuts(colour_angle_rad=0.02, half_resolution=True)
    assert_sound(scene.render(CASES[name][1], RenderOptions(exactness=exactness, shortcuts=shortcuts)))


@pytest.mark.parametrize("exactness", Exactness)
@pytest.mark.parametrize(
    "name", ["one depth", "one depth, camera tilted", "one position", "odd size", "2^16 in one tile"]
)
def test_permuting_the_input_leaves_the_picture_unchanged(name, exactness):
    _, scene = rendered(name)
    make, cam = CASES[name]
    splats = make()
    order = np.random.default_rng(0).permutation(len(splats))
    options = RenderOptions(exactness=exactness)
    shuffled = create("cpu").load(splats.take(order)).render(cam, options)
    np.testing.assert_allclose(shuffled.rgb, scene.render(cam, options).rgb, atol=1e-6)


@pytest.mark.parametrize("backend", ["reference", "cpu"])
def test_permuting_the_input_leaves_the_reference_unchanged_too(backend):
    splats, cam = one_depth().take(slice(0, 800)), tilted_camera(48, 32)
    order = np.random.default_rng(0).permutation(len(splats))
    views = [create(backend).load(s).render(cam, RenderOptions()).rgb for s in (splats, splats.take(order))]
    np.testing.assert_allclose(*views, atol=1e-6)
