"""Scenes and cameras that are hard to draw, for the tests of every backend."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.splats import Splats
from support.raster_scenes import F, camera, random_splats, splat, tilted_camera

RNG_SEED = 11


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
