"""Alignment in vectorised float32 numpy and OpenCV: what runs where the kernels are not installed."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from cags_client.align.base import Aligned, AlignSettings, ReferencePicture, cell_size, reprojection
from cags_common.geometry import F32, Camera

Mask = NDArray[np.bool_]


class FastAligner:
    """The same result as :class:`cags_client.align.reference.ReferenceAligner` to a 1/32 pixel of sampling."""

    name = "fast"

    def __init__(self, settings: AlignSettings | None = None) -> None:
        self._settings = settings or AlignSettings()

    def align(self, reference: ReferencePicture, depth: F32, camera: Camera) -> Aligned:
        """See :class:`cags_client.align.base.Aligner`."""
        if depth.shape != (camera.height_px, camera.width_px):
            raise ValueError(f"depth of shape {depth.shape} under a camera of {camera.width_px}x{camera.height_px}")
        s, w, h = self._settings, reference.camera.width_px, reference.camera.height_px
        with np.errstate(invalid="ignore", over="ignore"):
            known = np.isfinite(depth) & (depth > 0)
            d = np.where(known, depth, np.float32(1.0)).astype(np.float32, copy=False)
            x, y, z = _project(d, camera, reference.camera)
            inside = known & (z > 0) & (x >= 0) & (y >= 0) & (x <= w) & (y <= h)
        x, y = np.where(inside, x, np.float32(0)), np.where(inside, y, np.float32(0))
        sx, sy = cell_size(camera, reference.camera)
        slack = np.float32(s.slope_cells * sx) * _slope(d, known, 1)
        slack += np.float32(s.slope_cells * sy) * _slope(d, known, 0)
        cell = y.astype(np.int32) * (w + 1) + x.astype(np.int32)
        occluded, occluder = _occlusion(z, slack, inside, cell, (sx, sy), tolerance=s.depth_tolerance)
        rgb = sample(reference.rgb, x, y)
        rgb[~inside] = 0.0
        _erode(rgb, occluded, inside & ~occluded & ~occluder, s)
        distance = np.minimum(np.minimum(x, w - x), np.minimum(y, h - y))
        confidence = np.clip(distance / np.float32(max(s.border_px, 1e-6)), 0, 1) * (inside & ~occluded)
        return Aligned(rgb, confidence.astype(np.float32, copy=False), occluded, x, y)


def sample(image: F32, x: F32, y: F32) -> F32:
    """Bilinear samples [H, W, C] of ``image`` at continuous pixels; the edge pixel holds past the outermost centres."""
    sampled = cv2.remap(image, x - 0.5, y - 0.5, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(sampled, dtype=np.float32).reshape(*x.shape, *image.shape[2:])


def _project(d: F32, camera: Camera, reference: Camera) -> tuple[F32, F32, F32]:
    m, b = (a.astype(np.float32) for a in reprojection(camera, reference))
    u = np.arange(camera.width_px, dtype=np.float32)[None] + np.float32(0.5)
    v = np.arange(camera.height_px, dtype=np.float32)[:, None] + np.float32(0.5)
    z = d * (m[2, 0] * u + (m[2, 1] * v + m[2, 2])) + b[2]
    inverse = 1 / np.where(z > 0, z, np.float32(np.nan))
    x = (d * (m[0, 0] * u + (m[0, 1] * v + m[0, 2])) + b[0]) * inverse
    y = (d * (m[1, 0] * u + (m[1, 1] * v + m[1, 2])) + b[1]) * inverse
    return x, y, z


def _occlusion(
    z: F32, slack: F32, inside: Mask, cell: NDArray[np.int32], cell_px: tuple[float, float], *, tolerance: float
) -> tuple[Mask, Mask]:
    """Pixels behind the nearest one of their reference pixel, and the ones in front of those."""
    width, (sx, sy) = z.shape[1], cell_px
    # Positive floats order as their bits do, so that one minimum gives the nearest pixel and, of equals, the first.
    index = np.arange(z.size, dtype=np.uint64).reshape(z.shape)
    key = (np.where(inside, z, np.float32(0)).view(np.uint32).astype(np.uint64) << np.uint64(32)) | index
    nearest = np.full(int(cell.max()) + 1, np.uint64(0x7F800000) << np.uint64(32))
    np.minimum.at(nearest, cell[inside], key[inside])
    depth = (nearest >> np.uint64(32)).astype(np.uint32).view(np.float32)
    occluded = inside & (z > depth[cell] * np.float32(1 + tolerance) + slack)
    rows, columns = np.nonzero(occluded)  # few: look closer at these alone
    first = (nearest[cell[rows, columns]] & np.uint64(0xFFFFFFFF)).astype(np.int64)
    away = (np.abs(columns - first % width) > sx) | (np.abs(rows - first // width) > sy)
    occluded[rows[~away], columns[~away]] = False
    shared = np.zeros(len(nearest), dtype=bool)
    shared[cell[occluded]] = True
    return occluded, inside & ~occluded & shared[cell]


def _slope(d: F32, known: Mask, axis: int) -> F32:
    if axis == 0:
        return _slope(d.T, known.T, 1).T
    step = np.abs(np.diff(d, axis=1))
    step[~(known[:, 1:] & known[:, :-1])] = np.inf
    out = np.full(d.shape, np.inf, np.float32)
    out[:, 1:] = step
    np.minimum(out[:, :-1], step, out=out[:, :-1])
    out[np.isinf(out)] = 0
    return out


def _erode(rgb: F32, occluded: Mask, clean: Mask, settings: AlignSettings) -> None:
    """Fill holes in place, ring by ring, from a list of their pixels: holes are few."""
    r = settings.erosion_radius_px
    if not r or not settings.erosion_iterations or not occluded.any():
        return
    h, w = occluded.shape
    padded = np.pad(np.where(clean[..., None], rgb, 0), ((r, r), (r, r), (0, 0))).reshape(-1, 3)
    ready = np.pad(clean, r).reshape(-1).astype(np.float32)
    stride = w + 2 * r
    rows, columns = np.nonzero(occluded)
    holes = (rows + r) * stride + columns + r
    window = (np.arange(-r, r + 1)[:, None] * stride + np.arange(-r, r + 1)).reshape(-1)
    for _ in range(settings.erosion_iterations):
        around = holes[:, None] + window
        weights = ready[around]
        count = weights.sum(axis=1)
        fill = count > 0.5
        if not fill.any():
            break
        colours = np.einsum("nk,nkc->nc", weights[fill], padded[around[fill]]) / count[fill, None]
        padded[holes[fill]], ready[holes[fill]] = colours, 1.0
        holes = holes[~fill]
    filled = ready.reshape(h + 2 * r, stride)[r : r + h, r : r + w] > 0.5
    chosen = filled & occluded
    rgb[chosen] = padded.reshape(h + 2 * r, stride, 3)[r : r + h, r : r + w][chosen]
