"""Small scenes, cameras and measures for the rasteriser's tests."""

from __future__ import annotations

import numpy as np

from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.raster import RenderedView
from cags_common.splats import SH_REST_OF_DEGREE, Splats

F = np.float32


def random_splats(
    count: int, *, degree: int = 0, seed: int = 0, log_scale: float = -3.0, spread: float = 1.0
) -> Splats:
    """A cloud around the origin, standard deviation ``spread``."""
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(count, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    return Splats(
        means=(rng.normal(size=(count, 3)) * spread).astype(F),
        quats=quats.astype(F),
        log_scales=(rng.normal(size=(count, 3)) * 0.7 + log_scale).astype(F),
        logit_opacities=(rng.normal(size=count) * 2).astype(F),
        sh0=(rng.normal(size=(count, 3)) * 0.6).astype(F),
        sh_rest=(rng.normal(size=(count, SH_REST_OF_DEGREE[degree], 3)) * 0.2).astype(F),
    )


def changed(splats: Splats, rows: np.ndarray, new: Splats) -> Splats:
    """``splats`` with the ``new`` ones at ``rows``."""
    columns = {name: array.copy() for name, array in splats.arrays()}
    for name, array in new.arrays():
        columns[name][rows] = array
    return Splats(**columns)


def splat(
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    scale: tuple[float, float, float] = (0.1, 0.1, 0.1),
    quat: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0),
    logit: float = 0.0,
    sh0: tuple[float, float, float] = (1.0, 0.5, 0.0),
) -> Splats:
    """One splat of SH degree 0."""
    return Splats(
        np.array([mean], F),
        np.array([quat], F),
        np.log(np.array([scale], np.float64)).astype(F),
        np.array([logit], F),
        np.array([sh0], F),
        np.zeros((1, 0, 3), F),
    )


def camera(
    width: int = 96, height: int = 64, *, distance: float = 5.0, fov_rad: float = 0.9, near: float = 0.2
) -> Camera:
    """Looking at the origin from the -Z side, image rows along +Y."""
    intrinsics = Intrinsics.of_fov(width, height, fov_rad, 2 * np.arctan(np.tan(fov_rad / 2) * height / width))
    return Camera(intrinsics, Pose((0.0, 0.0, -distance), (1.0, 0.0, 0.0, 0.0)), near)


def tilted_camera(width: int = 96, height: int = 64) -> Camera:
    """A camera with no axis along the world's."""
    return camera(width, height).at(Pose.looking_at((2.0, 1.5, -4.0), (0.1, 0.0, 0.2), (0.1, 1.0, 0.0)))


def psnr_db(a: np.ndarray, b: np.ndarray) -> float:
    """Peak 1; 200 for equal images."""
    error = float(np.mean((np.asarray(a, np.float64) - np.asarray(b, np.float64)) ** 2))
    return 200.0 if error < 1e-20 else -10 * float(np.log10(error))


def assert_sound(view: RenderedView) -> None:
    """Finite colours, alpha in [0, 1], depth positive or +inf."""
    assert np.isfinite(view.rgb).all()
    assert (view.rgb >= 0).all()
    assert ((view.alpha >= 0) & (view.alpha <= 1)).all()
    if view.depth is not None:
        assert (view.depth > 0).all()
    if view.contribution is not None:
        assert np.isfinite(view.contribution).all()
        assert (view.contribution >= 0).all()
