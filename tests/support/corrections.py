"""Drawn views and references for the tests of the correction: made without a rasteriser, so that cases are exact."""

from __future__ import annotations

import math

import cv2
import numpy as np

from cags_common.correction import Reference, compand
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.raster import RenderedView

F = np.float32
Size = tuple[int, int]


def camera(
    size: Size, *, fov_rad: float = 1.2, at: tuple[float, float, float] = (0.0, 0.0, 0.0), turned_rad: float = 0.0
) -> Camera:
    """``size`` is width and height; looks along +Z, turned to the right about the vertical."""
    width, height = size
    intrinsics = Intrinsics.of_fov(width, height, fov_rad, 2 * math.atan(math.tan(fov_rad / 2) * height / width))
    return Camera(intrinsics, Pose(at, (math.cos(turned_rad / 2), 0.0, math.sin(turned_rad / 2), 0.0)))


def view(cam: Camera, *, holes: float = 0.0, seed: int = 0) -> RenderedView:
    """A wavy wall with discs before it; ``holes`` is about the share of the pixels that nothing is known of."""
    rng = np.random.default_rng(seed)
    height, width = cam.height_px, cam.width_px
    v, u = np.indices((height, width), dtype=np.float64)
    u, v = (u + 0.5) / width, (v + 0.5) / height
    depth = 3 + 0.5 * np.sin(9 * u) + v
    for _ in range(12):
        x, y, radius, near = rng.random(4)
        depth = np.where((u - x) ** 2 + (v - y) ** 2 < (0.15 * radius) ** 2, 1 + 1.5 * near, depth)
    alpha = np.ones((height, width), F)
    if holes:
        open_at = 0.5 + 0.5 * np.sin(11 * u) * np.sin(13 * v) < holes
        alpha[open_at], depth[open_at] = 0.0, np.inf
    return RenderedView(rng.random((height, width, 3), dtype=F), alpha, depth.astype(F), None)


def empty_view(cam: Camera) -> RenderedView:
    """What a client without splats draws."""
    size = cam.height_px, cam.width_px
    return RenderedView(np.zeros((*size, 3), F), np.zeros(size, F), np.full(size, np.inf, F), None)


def flat_view(cam: Camera, depth: float, colour: float = 0.5) -> RenderedView:
    """A wall of one depth and colour."""
    size = cam.height_px, cam.width_px
    return RenderedView(np.full((*size, 3), colour, F), np.ones(size, F), np.full(size, depth, F), None)


def lack(size: Size, *, seed: int = 3, contrast: float = 0.3) -> np.ndarray:
    """A smooth difference [h, w, 3] in [-1, 1]."""
    noise = np.random.default_rng(seed).normal(size=(size[1], size[0], 3))
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.2) if min(size) > 8 else noise
    return np.clip(smooth * (contrast / max(float(smooth.std()), 1e-9)), -1, 1)


def difference(cam: Camera, *, knee: float = 0.1, seed: int = 3, contrast: float = 0.3) -> Reference:
    """A companded difference seen from ``cam``."""
    shown = lack((cam.width_px, cam.height_px), seed=seed, contrast=contrast)
    return Reference(compand(shown, knee).astype(F), cam, knee=knee)


def picture(cam: Camera, *, seed: int = 4) -> Reference:
    """A picture of a scene seen from ``cam``."""
    return Reference(np.random.default_rng(seed).random((cam.height_px, cam.width_px, 3), dtype=F), cam, picture=True)


def assert_sound(rgb: np.ndarray, confidence: np.ndarray) -> None:
    """Finite, and in [0, 1]."""
    for name, image in (("rgb", rgb), ("confidence", confidence)):
        assert image.dtype == F, name
        assert np.isfinite(image).all(), name
        assert ((image >= 0) & (image <= 1)).all(), name


def share_apart(ours: np.ndarray, right: np.ndarray) -> float:
    """Share of the pixels with a channel that differs by more than one level of 255."""
    return float((np.abs(ours.astype(np.float64) - right) > 1 / 255).any(axis=2).mean())
