"""The readable definition of alignment, in float64. Every other aligner is tested against this one.

Differences from the paper's pseudocode, all deliberate:

- ``K_r`` in the projection, and the *projected* depth compared with the minimum at the same reference pixel;
- a threshold relative to depth, which allows for the surface's own slope;
- two pixels that lie within one reference pixel in the *client's* view too do not hide each other: the reference sees
  both, and an identity has no occlusion;
- points behind the reference are invalid;
- pixels that share a reference pixel with an occluded one but lie in front of it are seen, and yet not averaged from
  (the authors' "occluders");
- each erosion step reads only the state before it, so its result does not depend on the order of writes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_client.frame.align.base import Aligned, AlignSettings, Reprojection
from cags_client.store.picture import ReferencePicture
from cags_common.geometry import F32, F64, Camera

Mask = NDArray[np.bool_]


class OracleAligner:
    """Float64, one idea a line, slow."""

    name = "oracle"

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
        d = np.where(np.isfinite(depth) & (depth > 0), depth, np.nan).astype(np.float64)
        x, y, z = _project(d, geometry)
        inside = (z > 0) & (x >= 0) & (y >= 0) & (x <= reference.camera.width_px) & (y <= reference.camera.height_px)
        nowhere = np.zeros_like(inside)
        seen = _Projected(x, y, z, inside)
        occluded, occluder = self._occlusion(d, seen, geometry) if occlusion else (nowhere, nowhere)
        rgb = np.where(inside[..., None], _bilinear(reference.rgb.astype(np.float64), x, y), 0.0)
        rgb = _erode(rgb, occluded, inside & ~occluded & ~occluder, self._settings)
        confidence = np.where(inside & ~occluded, _border(x, y, reference.camera, self._settings.border_px), 0.0)
        painted = rgb.astype(np.float32)
        return Aligned(lambda: painted, confidence.astype(np.float32), occluded, geometry)

    def _occlusion(self, d: F64, p: _Projected, geometry: Reprojection) -> tuple[Mask, Mask]:
        """Which pixels the reference does not see, and which of the seen ones share a reference pixel with those."""
        inside, z = p.inside, p.z
        cells, cell = p.cells()
        row, column = np.indices(d.shape)
        sampled = inside & (row % geometry.stride == 0) & (column % geometry.stride == 0)
        nearest = np.full(cells, np.inf)
        np.minimum.at(nearest, cell[sampled], z[sampled])
        index = np.arange(d.size).reshape(d.shape)
        first = np.full(cells, d.size)  # the nearest pixel itself; of equally near ones the first
        is_nearest = sampled & (z == nearest[cell])
        np.minimum.at(first, cell[is_nearest], index[is_nearest])
        sx, sy = geometry.cell_px
        away = (np.abs(column - first[cell] % d.shape[1]) > sx) | (np.abs(row - first[cell] // d.shape[1]) > sy)
        slack = self._settings.slope_cells * (sx * _slope(d, axis=1) + sy * _slope(d, axis=0))
        occluded = np.zeros(d.shape, dtype=bool)
        limit = nearest[cell] * (1 + self._settings.depth_tolerance) + slack
        occluded[inside] = (z[inside] > limit[inside]) & away[inside]
        shared = np.zeros(cells, dtype=bool)
        shared[cell[occluded]] = True
        return occluded, inside & ~occluded & shared[cell]


@dataclass(frozen=True, eq=False)
class _Projected:
    """Client pixels [H, W] in the reference: continuous pixel, depth, and whether that means anything."""

    x: F64
    y: F64
    z: F64
    inside: Mask

    def cells(self) -> tuple[int, NDArray[np.int64]]:
        """Number of reference pixels that may be touched, and the one [H, W] that each client pixel lies in."""
        column = np.where(self.inside, self.x, 0.0).astype(np.int64)
        row = np.where(self.inside, self.y, 0.0).astype(np.int64)
        stride = int(column.max()) + 1
        return stride * (int(row.max()) + 1), row * stride + column


def _project(d: F64, geometry: Reprojection) -> tuple[F64, F64, F64]:
    """Continuous reference pixels and reference depth of every client pixel; NaN where the client sees nothing."""
    m, b = geometry.matrix
    v, u = np.indices(d.shape) + 0.5
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ m.T
    p = rays * d[..., None] + b
    z = np.where(p[..., 2] > 0, p[..., 2], np.nan)
    return p[..., 0] / z, p[..., 1] / z, z


def _slope(d: F64, axis: int) -> F64:
    """Smaller of the depth steps to the two neighbours along an axis: the surface's slope, not a silhouette's jump.

    A step to a void pixel or over the image's edge does not count.
    """
    step = np.abs(np.diff(d, axis=axis))
    edge = np.full_like(np.take(d, [0], axis=axis), np.nan)
    both = np.stack([np.concatenate([edge, step], axis=axis), np.concatenate([step, edge], axis=axis)])
    smaller = np.fmin(both[0], both[1])
    return np.asarray(np.where(np.isnan(smaller), 0.0, smaller), dtype=np.float64)


def _bilinear(image: F64, x: F64, y: F64) -> F64:
    """Sample at continuous pixels; past the outermost centres the edge pixel holds."""
    h, w = image.shape[:2]
    fx = np.clip(np.nan_to_num(x) - 0.5, 0, w - 1)
    fy = np.clip(np.nan_to_num(y) - 0.5, 0, h - 1)
    x0, y0 = np.minimum(fx.astype(int), max(w - 2, 0)), np.minimum(fy.astype(int), max(h - 2, 0))
    x1, y1 = np.minimum(x0 + 1, w - 1), np.minimum(y0 + 1, h - 1)
    ax, ay = (fx - x0)[..., None], (fy - y0)[..., None]
    top = image[y0, x0] * (1 - ax) + image[y0, x1] * ax
    bottom = image[y1, x0] * (1 - ax) + image[y1, x1] * ax
    return np.asarray(top * (1 - ay) + bottom * ay, dtype=np.float64)


def _border(x: F64, y: F64, reference: Camera, width_px: float) -> F64:
    distance = np.minimum(np.minimum(x, reference.width_px - x), np.minimum(y, reference.height_px - y))
    return np.asarray(np.clip(np.nan_to_num(distance) / max(width_px, 1e-6), 0.0, 1.0), dtype=np.float64)


def _erode(rgb: F64, occluded: Mask, clean: Mask, settings: AlignSettings) -> F64:
    """Fill occluded pixels with the mean of the clean ones around them, ring by ring."""
    rgb, holes, clean = rgb.copy(), occluded.copy(), clean.copy()
    r = settings.erosion_radius_px
    for _ in range(settings.erosion_iterations if r else 0):
        total = _box_sum(np.where(clean[..., None], rgb, 0.0), r)
        count = _box_sum(clean[..., None].astype(np.float64), r)[..., 0]
        filled = holes & (count > 0.5)
        if not filled.any():
            break
        rgb[filled] = total[filled] / count[filled][:, None]
        clean |= filled
        holes &= ~filled
    return rgb


def _box_sum(image: F64, radius: int) -> F64:
    """Sum over the (2 radius + 1)^2 window; outside the image counts as nothing."""
    h, w = image.shape[:2]
    padded = np.pad(image, ((radius, radius), (radius, radius), (0, 0)))
    out = np.zeros_like(image)
    for dy in range(2 * radius + 1):
        for dx in range(2 * radius + 1):
            out += padded[dy : dy + h, dx : dx + w]
    return out
