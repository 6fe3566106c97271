"""Views around a scene, and the quality of splats seen from them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cags_common.geometry import F32, Camera, Intrinsics, Pose
from cags_common.lpips import Lpips
from cags_common.metrics import covered_mask, ssim
from cags_common.raster import DepthKind, Rasteriser, RenderedView, RenderOptions
from cags_common.splats import Splats
from cags_encoder.scenes import FrameSource

FOV_RAD = math.radians(50)
DISTANCES = (2.1, 1.6)
_OPTIONS = RenderOptions(depth=DepthKind.NONE)


@dataclass(frozen=True, slots=True)
class Quality:
    """Means over the views."""

    psnr_db: float
    ssim: float
    lpips: float | None


def views_around(source: FrameSource, count: int, width_px: int) -> list[Camera]:
    """``count`` cameras on a ring slightly above the focus, alternately far and near."""
    focus, up = source.focus, np.asarray(source.up) / np.linalg.norm(source.up)
    aside = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    aside /= np.linalg.norm(aside)
    ahead = np.cross(up, aside)
    height_px = width_px * 3 // 4
    intrinsics = Intrinsics.of_fov(width_px, height_px, FOV_RAD, FOV_RAD * height_px / width_px)
    out = []
    for view in range(count):
        turn = 2 * math.pi * (view + 0.5) / count
        direction = math.cos(turn) * aside + math.sin(turn) * ahead + 0.3 * up
        x, y, z = np.asarray(focus.centre) + focus.radius * DISTANCES[view % 2] * direction
        pose = Pose.looking_at((float(x), float(y), float(z)), focus.centre, source.up)
        out.append(Camera(intrinsics, pose, min(0.2, focus.radius / 10)))
    return out


class Judge:
    """Compares pictures of splats with those of the true ones."""

    def __init__(self, truth: Splats, cameras: Sequence[Camera], rasteriser: Rasteriser, lpips: Lpips | None) -> None:
        self._cameras, self._rasteriser, self._lpips = cameras, rasteriser, lpips
        self._truth = self._draw(truth)

    def __call__(self, splats: Splats) -> Quality:
        """Quality of pictures of ``splats``: PSNR and SSIM over covered pixels, LPIPS over the whole picture."""
        pairs = [_pair(true, shown) for true, shown in zip(self._truth, self._draw(splats), strict=True)]
        psnr = [-10 * math.log10(float(np.square(a - b)[mask].mean()) + 1e-10) for a, b, mask in pairs if mask.any()]
        ssims = [ssim(b, a, mask) for a, b, mask in pairs]
        distances = [self._lpips.distance(a, b) for a, b, _ in pairs] if self._lpips else []
        mean = float(np.mean(distances)) if distances else None
        return Quality(float(np.mean(psnr)) if psnr else 100.0, float(np.mean(ssims)), mean)

    def _draw(self, splats: Splats) -> list[RenderedView]:
        scene = self._rasteriser.load(splats)
        return [scene.render(camera, _OPTIONS) for camera in self._cameras]


def _pair(true: RenderedView, shown: RenderedView) -> tuple[F32, F32, np.ndarray]:
    mask = covered_mask(np.maximum(true.alpha, shown.alpha))
    return np.clip(true.rgb, 0, 1), np.clip(shown.rgb, 0, 1), mask
