"""Alignment in vectorised float32 numpy and OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from cags_client.frame.align.base import Aligned, AlignSettings, Reprojection
from cags_client.store.picture import ReferencePicture
from cags_common.geometry import F32, Camera

Mask = NDArray[np.bool_]


class FastAligner:
    """The same result as :class:`cags_research.align.oracle.OracleAligner` to a 1/32 pixel of sampling."""

    name = "fast"

    def __init__(self, settings: AlignSettings | None = None) -> None:
        self._settings = settings or AlignSettings()

    def align(
        self,
        reference: ReferencePicture,
        depth: F32,
        camera: Camera,
        *,
        occlusion: bool = True,
        colours: bool = False,
    ) -> Aligned:
        """See :class:`cags_client.frame.align.base.Aligner`."""
        geometry = Reprojection(depth, camera, reference.camera)
        s, w, h = self._settings, reference.camera.width_px, reference.camera.height_px
        x, y, _, inside = geometry.projected
        cell = y.astype(np.int32) * (w + 1) + x.astype(np.int32)
        occluded, occluder = _occlusion(geometry, cell, s) if occlusion else (np.zeros_like(inside),) * 2
        distance = np.minimum(np.minimum(x, w - x), np.minimum(y, h - y))
        confidence = np.clip(distance / np.float32(max(s.border_px, 1e-6)), 0, 1) * (inside & ~occluded)

        def paint() -> F32:
            rgb = sample(reference.rgb, x, y)
            rgb[~inside] = 0.0
            _erode(rgb, occluded, inside & ~occluded & ~occluder, s)
            return rgb

        aligned = Aligned(paint, confidence.astype(np.float32, copy=False), occluded, geometry)
        if colours:
            _ = aligned.rgb  # kept by the object
        return aligned


def sample(image: F32, x: F32, y: F32) -> F32:
    """Bilinear samples [H, W, C] of ``image`` at continuous pixels; the edge pixel holds past the outermost centres.

    Three channels at a time: with more than four, OpenCV rounds the position to a 1/32 pixel.
    """
    out = np.empty((*x.shape, image.shape[2]), np.float32)
    for first in range(0, image.shape[2], 3):
        part = np.ascontiguousarray(image[..., first : first + 3])
        sampled = cv2.remap(part, x - 0.5, y - 0.5, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        out[..., first : first + 3] = sampled.reshape(*x.shape, part.shape[2])
    return out


def _occlusion(geometry: Reprojection, cell: NDArray[np.int32], settings: AlignSettings) -> tuple[Mask, Mask]:
    """Pixels behind the nearest one of their reference pixel, and the ones in front of those."""
    _, _, z, inside = geometry.projected
    known = np.isfinite(geometry.depth) & (geometry.depth > 0)
    (sx, sy), stride, width = geometry.cell_px, geometry.stride, z.shape[1]
    # Positive floats order as their bits do, so that one minimum gives the nearest pixel and, of equals, the first.
    index = np.arange(z.size, dtype=np.uint64).reshape(z.shape)
    key = ((z.view(np.uint32).astype(np.uint64) << np.uint64(32)) | index)[::stride, ::stride]
    sampled = inside[::stride, ::stride]
    nearest = np.full(int(cell.max()) + 1, np.uint64(0x7F800000) << np.uint64(32))
    np.minimum.at(nearest, cell[::stride, ::stride][sampled], key[sampled])
    depth = (nearest >> np.uint64(32)).astype(np.uint32).view(np.float32)
    slack = np.float32(settings.slope_cells * sx) * _slope(geometry.depth, known, 1)
    slack += np.float32(settings.slope_cells * sy) * _slope(geometry.depth, known, 0)
    occluded = inside & (z > depth[cell] * np.float32(1 + settings.depth_tolerance) + slack)
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
    with np.errstate(invalid="ignore", over="ignore"):
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
