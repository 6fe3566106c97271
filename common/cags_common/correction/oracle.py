"""The readable definition of the client's last step (float64): sample what is lacking by depth, and lay it over.

Kernels and shaders are tested against it, and it serves while there are none. Its steps: the reference is *expanded* to
what the client lacks, a layer of colour and opacity (0: a difference, which is added); the depth's *holes* are filled
from around them (pull-push over inverse depth); each pixel is *projected* into the reference, beyond which it takes the
sample of the nearest point, fading with the distance (holes do not fade: they are never black); the sample is *laid
over* the pixel, but where something nearer hides it from the reference (z-test): it takes the mean of what was added in
its *surroundings*.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cags_common.correction.base import (
    CELL_PX,
    FAR,
    LEAST_AROUND_PX,
    VETO_CELL_PX,
    Corrected,
    CorrectSettings,
    Placement,
    Reference,
    checked_depth,
    checked_own,
    checked_veto,
)
from cags_common.correction.compander import expand
from cags_common.correction.trust import layer
from cags_common.geometry import F32, F64, Camera
from cags_common.raster.base import RenderedView

LEAST_WEIGHT = 1e-6


class ReferenceCorrector:
    """The definition behind the seam; keeps the render from the reference camera that came with a picture."""

    name = "oracle"

    def __init__(self) -> None:
        self._held: tuple[Reference, F32] | None = None

    def needs_own(self, reference: Reference) -> bool:
        """Whether a picture is new."""
        return reference.picture and (self._held is None or self._held[0] is not reference)

    def correct(
        self,
        view: RenderedView,
        camera: Camera,
        reference: Reference,
        own: F32 | None = None,
        settings: CorrectSettings | None = None,
        *,
        veto: F32 | None = None,
    ) -> Corrected:
        """See :class:`.base.Corrector`."""
        if own is not None:
            self._held = reference, own
        elif not self.needs_own(reference) and self._held is not None:
            own = self._held[1]
        return correct(view, camera, reference, own, settings, veto=veto)


def lacking(reference: Reference, own: F32 | None) -> F64:
    """The layer over the client's view [h, w, 4]: colour in [-1, 1], premultiplied, and opacity in [0, 1].

    ``own``, for pictures, is the client's view from their camera.
    """
    if not reference.picture:
        added = expand(reference.coded, reference.knee)
        return np.concatenate([added, np.zeros_like(added[..., :1])], axis=-1)
    if own is None:
        raise ValueError("a reference that is a picture needs the client's render from the reference camera")
    return layer(reference.coded, checked_own(own, reference), reference.error).astype(np.float64)


def correct(
    view: RenderedView,
    camera: Camera,
    reference: Reference,
    own: F32 | None = None,
    settings: CorrectSettings | None = None,
    *,
    veto: F32 | None = None,
) -> Corrected:
    """See :class:`.base.Corrector`; nothing is kept between calls."""
    settings = settings or CorrectSettings()
    thin = view.alpha < settings.hole_alpha
    placement = Placement(camera, reference.camera)
    depth = filled(np.where(thin, np.inf, checked_depth(view, camera).astype(np.float64)))
    x, y, z, beyond, ahead = _placed(depth, placement)
    hidden = _hidden(depth, (x, y, z), ahead & (beyond <= 0), placement, settings)
    fade = np.where(ahead, np.clip(1.0 - beyond / max(settings.border_px, 1e-6), 0.0, 1.0), 0.0)
    empty = np.where(thin & ahead, np.clip(1.0 - view.alpha / max(settings.hole_alpha, 1e-6), 0.0, 1.0), 0.0)
    weight = np.maximum(fade, empty)
    if veto is not None:
        weight = weight * (1.0 - np.clip(_spread(checked_veto(veto, camera), camera), 0.0, 1.0))
    confidence = np.where(hidden, 0.0, weight)
    over = _sampled(lacking(reference, own), x, y)
    added = confidence[..., None] * (over[..., :3] - over[..., 3:] * view.rgb)
    around = weight[..., None] * _surroundings(added, confidence)
    rgb = np.clip(view.rgb + np.where(hidden[..., None], around, added), 0.0, 1.0)
    return Corrected(rgb.astype(np.float32), confidence.astype(np.float32))


def _surroundings(added: F64, confidence: F64) -> F64:
    """Mean of what was added [H, W, 3] around every pixel, by confidence; less where that is of few pixels."""
    height, width = confidence.shape
    u, v = (np.arange(width) + 0.5) / CELL_PX, (np.arange(height) + 0.5) / CELL_PX
    total = np.maximum(_bilinear(_cell_sums(confidence), u, v), LEAST_AROUND_PX)
    return np.stack([_bilinear(_cell_sums(added[..., c]), u, v) / total for c in range(3)], axis=-1)


def _spread(veto: F32, camera: Camera) -> F64:
    """``veto`` at every pixel."""
    if veto.shape == (camera.height_px, camera.width_px):
        return veto.astype(np.float64)
    u, v = ((np.arange(n) + 0.5) / VETO_CELL_PX for n in (camera.width_px, camera.height_px))
    return _bilinear(veto.astype(np.float64), u, v)


def filled(depth: F64) -> F64:
    """``depth`` [H, W] with its holes (+inf) filled from around them; in [1 / FAR, FAR] everywhere."""
    known = np.isfinite(depth) & (depth >= 1.0 / FAR)
    weight = known.astype(np.float64)
    inverse = weight / np.where(known, np.minimum(depth, FAR), 1.0)
    pixels = _cell_sums(np.ones_like(depth))
    total = _cell_sums(weight)
    smooth = _pushed(_cell_sums(inverse) / np.maximum(total, LEAST_WEIGHT), total / pixels)
    height, width = depth.shape
    u, v = (np.arange(width) + 0.5) / CELL_PX, (np.arange(height) + 0.5) / CELL_PX
    around = 1.0 / np.maximum(_bilinear(smooth, u, v), 1.0 / FAR)
    return np.where(known, np.minimum(depth, FAR), around)


def _cell_sums(image: F64) -> F64:
    """Sums over the cells [ceil(H / 8), ceil(W / 8)]; those at the edge may be smaller."""
    rows, columns = np.arange(0, image.shape[0], CELL_PX), np.arange(0, image.shape[1], CELL_PX)
    return np.asarray(np.add.reduceat(np.add.reduceat(image, rows, axis=0), columns, axis=1))


def _pushed(values: F64, weights: F64) -> F64:
    """``values`` where ``weights`` are 1, and a level of half the size of the same where they are less."""
    if values.size == 1:
        return values
    rows, columns = np.arange(0, values.shape[0], 2), np.arange(0, values.shape[1], 2)

    def summed(image: F64) -> F64:
        return np.asarray(np.add.reduceat(np.add.reduceat(image, rows, axis=0), columns, axis=1))

    total = summed(weights)
    coarse = _pushed(summed(values * weights) / np.maximum(total, LEAST_WEIGHT), np.minimum(total, 1.0))
    u, v = (np.arange(values.shape[1]) + 0.5) / 2, (np.arange(values.shape[0]) + 0.5) / 2
    around = _bilinear(coarse, u, v)
    share = np.minimum(weights, 1.0)
    return np.asarray(values * share + around * (1 - share))


def _bilinear(image: F64, u: F64, v: F64) -> F64:
    """``image`` [h, w] at the grid of columns ``u`` [W] and rows ``v`` [H]; the edge pixel holds beyond the centres."""
    fx, fy = np.clip(u - 0.5, 0, image.shape[1] - 1), np.clip(v - 0.5, 0, image.shape[0] - 1)
    x0, y0 = np.floor(fx).astype(int), np.floor(fy).astype(int)
    x1, y1 = np.minimum(x0 + 1, image.shape[1] - 1), np.minimum(y0 + 1, image.shape[0] - 1)
    ax, ay = (fx - x0)[None], (fy - y0)[:, None]
    top = image[y0][:, x0] * (1 - ax) + image[y0][:, x1] * ax
    bottom = image[y1][:, x0] * (1 - ax) + image[y1][:, x1] * ax
    return np.asarray(top * (1 - ay) + bottom * ay)


def _placed(depth: F64, placement: Placement) -> tuple[F64, F64, F64, F64, NDArray[np.bool_]]:
    """x, y (the nearest point of the reference), z of each pixel; how far beyond the reference it lies, pixels, along
    the axis on which that is more; whether before the camera.
    """
    v, u = np.indices(depth.shape) + 0.5
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ placement.matrix[:, :3].T
    p = rays * depth[..., None] + placement.matrix[:, 3]
    z = p[..., 2]
    ahead = z > 0
    safe = np.where(ahead, z, 1.0)
    x, y = p[..., 0] / safe, p[..., 1] / safe
    width, height = placement.reference.width_px, placement.reference.height_px
    near_x, near_y = (np.where(ahead, np.clip(at, 0.0, most), 0.0) for at, most in ((x, width), (y, height)))
    beyond = np.maximum(np.abs(x - near_x), np.abs(y - near_y))
    return near_x, near_y, np.where(ahead & (beyond <= 0), z, 0.0), beyond, ahead


def _hidden(
    depth: F64,
    place: tuple[F64, F64, F64],
    inside: NDArray[np.bool_],
    placement: Placement,
    settings: CorrectSettings,
) -> NDArray[np.bool_]:
    """Pixels that the reference does not see: behind the nearest one of the same reference pixel, and apart from it."""
    x, y, z = place
    row, column = np.indices(depth.shape)
    cell = y.astype(np.int64) * (placement.reference.width_px + 1) + x.astype(np.int64)
    cells = (placement.reference.width_px + 1) * (placement.reference.height_px + 1)
    sampled = inside & (row % placement.stride == 0) & (column % placement.stride == 0)
    nearest = np.full(cells, np.inf)
    np.minimum.at(nearest, cell[sampled], z[sampled])
    is_nearest = sampled & (z == nearest[cell])
    first = np.full(cells, depth.size)
    np.minimum.at(first, cell[is_nearest], np.arange(depth.size).reshape(depth.shape)[is_nearest])
    sx, sy = placement.cell_px
    away = (np.abs(column - first[cell] % depth.shape[1]) > sx) | (np.abs(row - first[cell] // depth.shape[1]) > sy)
    slack = settings.slope_cells * (sx * _slope(depth, 1) + sy * _slope(depth, 0))
    return np.asarray(inside & away & (z > nearest[cell] * (1 + settings.depth_tolerance) + slack))


def _slope(depth: F64, axis: int) -> F64:
    """The smaller of the depth steps to the two neighbours along an axis; 0 where there is none."""
    step = np.abs(np.diff(depth, axis=axis))
    if not step.size:
        return np.zeros_like(depth)
    edge = np.full_like(np.take(depth, [0], axis=axis), np.inf)
    both = np.minimum(np.concatenate([edge, step], axis=axis), np.concatenate([step, edge], axis=axis))
    return np.asarray(both)


def _sampled(image: F64, x: F64, y: F64) -> F64:
    """``image`` [h, w, n] at continuous pixels [H, W]; past the outermost centres the edge pixel holds."""
    h, w = image.shape[:2]
    fx, fy = np.clip(x - 0.5, 0, w - 1), np.clip(y - 0.5, 0, h - 1)
    x0, y0 = np.floor(fx).astype(int), np.floor(fy).astype(int)
    x1, y1 = np.minimum(x0 + 1, w - 1), np.minimum(y0 + 1, h - 1)
    ax, ay = (fx - x0)[..., None], (fy - y0)[..., None]
    top = image[y0, x0] * (1 - ax) + image[y0, x1] * ax
    bottom = image[y1, x0] * (1 - ax) + image[y1, x1] * ax
    return np.asarray(top * (1 - ay) + bottom * ay)
