"""Where the splats are not those of the scene, the reference stands in for them.

Restoration corrects colours. Where a link too slow for the motion leaves splats of earlier frames on display, or holes
where there should be some, no colour is right: alignment by the client's depth tears the reference, and the closed form
fits it to the wrong thing. There the whole reference is better, bent by what can be known of the surface: the client's
depth, smoothed and carried over its holes.

Two errors decide, cell by cell of a coarse grid, both measured and neither assumed:

- *disagreement*: the reference against the client's own view of it, as far as no local fit of colours explains it (the
  part of the error that restoration must leave);
- *bending*: the client's own view, bent in the same way, against what the client draws (the error of standing in).

A static scene that is only coarse disagrees little, an exact one not at all, and a wrong surface bends badly: each
keeps its own picture, bit by bit.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

import cags_kernels
from cags_client.align import Aligner, ReferencePicture
from cags_client.align.base import Reprojection
from cags_client.align.fast import sample
from cags_common.geometry import F32, Camera, Intrinsics
from cags_common.raster.base import RenderedView

GRID_CELLS = 100
"""Cells along the width of the grids on which both errors are measured, of either view."""

WINDOW_CELLS = 7
"""Side of the window over which errors are taken together: an area, not an edge."""

USUAL_SHIFT = 0.06
"""Local shift of colour (0..1) that quantisation may cause; what goes beyond counts as disagreement."""

LEAST_ERROR = 0.03
"""Added to the bending error: below this much disagreement (RMS, 0..1) nothing stands in."""

STARTS, ENDS = 1.2, 1.8
"""Disagreement over bending error at which the reference begins to show, and shows alone."""

LEAST_SHARE = 0.005
"""Share of the picture below which standing in is not worth its time."""

FIT_FLOOR = 3e-4
"""Variance (summed over channels) under which a window is too plain to fit a gain to."""

LEAST_WEIGHT = np.float32(1e-6)

FAR = np.float32(1e6)
"""Depth in world units where the client holds nothing at all: only turning counts."""


@dataclass(frozen=True, eq=False)
class Drawn:
    """The client's own picture of a frame."""

    rgb: F32  # [H, W, 3] in [0, 1]
    alpha: F32  # [H, W]
    depth: F32  # [H, W] camera-space z; non-finite where void
    camera: Camera


class StandIn:
    """Paints the reference over what the client's splats cannot show. Keeps the disagreement of one reference."""

    def __init__(self, aligner: Aligner, threads: int = 2) -> None:
        self._aligner, self._threads = aligner, threads
        self._of: tuple[ReferencePicture, RenderedView] | None = None
        self._disagreement = np.zeros((1, 1), np.float32)
        self._own = np.zeros((1, 1, 3), np.float32)

    def paint(self, shown: F32, drawn: Drawn, reference: ReferencePicture, own: RenderedView, trust: float) -> F32:
        """``shown`` [H, W, 3], the restored picture, with the reference where it is the better of the two.

        ``own`` is the client's view of ``reference``; ``trust`` in [0, 1] weighs the whole. The same array where
        nothing stands in.
        """
        if self._of is None or self._of[0] is not reference or self._of[1] is not own:
            self._own = on_grid(own.rgb).clip(0.0, 1.0)
            self._disagreement = disagreement(on_grid(reference.rgb), self._own)
            self._of = reference, own
        if trust <= 0 or self._disagreement.max() <= STARTS * LEAST_ERROR:
            return shown
        depth = surrogate_depth(drawn)
        weight = self._weight(drawn, depth, reference) * np.float32(trust)
        if weight.mean() < LEAST_SHARE:
            return shown
        out = shown.copy()
        self._bend(out, drawn.camera, reference, depth, weight)
        return out

    def _bend(self, out: F32, camera: Camera, reference: ReferencePicture, depth: F32, weight: F32) -> None:
        """Blend the bent reference into ``out`` [H, W, 3], in the rectangle where ``weight`` [gh, gw] says anything."""
        height, width = out.shape[:2]
        share, full = _resized(weight, width, height), _resized(depth, width, height)
        left, top, columns, rows = cv2.boundingRect((share > 0).astype(np.uint8))
        part = np.s_[top : top + rows, left : left + columns]
        i = camera.intrinsics
        seen = Intrinsics(columns, rows, i.fx_px, i.fy_px, i.cx_px - left, i.cy_px - top)
        there = Camera(seen, camera.pose, camera.near)
        bent = self._aligner.align(reference, np.ascontiguousarray(full[part]), there, occlusion=False, colours=True)
        lay_over(out[part], bent.rgb, share[part], bent.confidence, self._threads)

    def _weight(self, drawn: Drawn, depth: F32, reference: ReferencePicture) -> F32:
        """How much the reference stands in [gh, gw] of the client's view."""
        rows, columns = depth.shape
        small = Camera(drawn.camera.intrinsics.resized(columns, rows), drawn.camera.pose, drawn.camera.near)
        r_rows, r_columns = self._disagreement.shape
        there = reference.camera
        cells = Camera(there.intrinsics.resized(r_columns, r_rows), there.pose, there.near)
        x, y, _, inside = Reprojection(depth, small, cells).projected
        bent = sample(self._own, x, y)
        disagreeing = sample(self._disagreement[..., None], x, y)[..., 0]
        bending = _rms(bent - on_grid(drawn.rgb))
        ratio = disagreeing / (bending + np.float32(LEAST_ERROR))
        return np.asarray(np.clip((ratio - STARTS) / (ENDS - STARTS), 0, 1) * inside, dtype=np.float32)


def lay_over(shown: F32, over: F32, share: F32, confidence: F32, threads: int) -> None:
    """Change ``shown`` [H, W, 3] towards ``over`` [H, W, 3] by ``share`` times ``confidence`` [H, W], in place."""
    if cags_kernels.native_available():
        from cags_kernels.align import lay

        lay(shown, over, share, confidence, threads)
    else:
        shown += (over - shown) * (share * confidence)[..., None]


def on_grid(picture: F32) -> F32:
    """Means [gh, gw, 3] of a picture [h, w, 3] over the cells of its grid."""
    return _averaged(_thinned(picture), *_grid(*picture.shape[1::-1]))


def disagreement(seen: F32, drawn: F32) -> F32:
    """RMS [gh, gw], 0..1, of what no local gain and offset of ``drawn`` [gh, gw, 3] explains of ``seen`` [gh, gw, 3].

    Of a reference and the client's own view of it, on their grid.
    A fit's offset would explain any shift of colours: what quantisation does not cause (:data:`USUAL_SHIFT`) counts.
    """
    mean_seen, mean_drawn = _window(seen), _window(drawn)
    covariance = _over_channels(_window(drawn * seen) - mean_drawn * mean_seen)
    variance = _over_channels(np.maximum(_window(drawn * drawn) - mean_drawn * mean_drawn, 0))
    gain = np.clip((covariance + FIT_FLOOR) / (variance + FIT_FLOOR), 0, 2)[..., None]
    left = _rms(seen - (mean_seen + gain * (drawn - mean_drawn)))
    shift = _over_channels(np.abs(mean_seen - mean_drawn)) / np.float32(3)
    return np.asarray(np.maximum(left, shift - USUAL_SHIFT), dtype=np.float32)


def surrogate_depth(drawn: Drawn) -> F32:
    """Smooth depth [gh, gw] of what the client draws, its holes filled from around them; :data:`FAR` where nothing is.

    Pull-push (Gortler et al., "The Lumigraph", 1996) over inverse depth, weighted by opacity.
    """
    height, width = drawn.alpha.shape
    columns, rows = _grid(width, height)
    depth, alpha = _thinned(drawn.depth), _thinned(drawn.alpha)
    known = np.isfinite(depth) & (depth > 1 / FAR)
    weight = np.where(known, alpha, np.float32(0))
    weighted = np.divide(weight, np.where(known, depth, np.float32(1)), dtype=np.float32)
    coarse = _averaged(weight, columns, rows)
    inverse = np.divide(_averaged(weighted, columns, rows), np.maximum(coarse, LEAST_WEIGHT), dtype=np.float32)
    smooth = cv2.GaussianBlur(_pulled(inverse, np.minimum(coarse, np.float32(1))), (0, 0), 1.0)
    return np.asarray(np.reciprocal(np.maximum(smooth, np.reciprocal(FAR))), dtype=np.float32)


def _pulled(values: F32, weights: F32) -> F32:
    """``values`` [h, w] where ``weights`` [h, w] are 1, and a coarser level of the same where they are less."""
    rows, columns = values.shape
    if min(rows, columns) <= 2:
        mean = np.float32((values * weights).sum() / max(weights.sum(), LEAST_WEIGHT))
        return np.asarray(values * weights + mean * (1 - weights), dtype=np.float32)
    half = (columns + 1) // 2, (rows + 1) // 2
    coarse_weights = _averaged(weights, *half)
    coarse = np.divide(_averaged(values * weights, *half), np.maximum(coarse_weights, LEAST_WEIGHT), dtype=np.float32)
    around = _resized(_pulled(coarse, np.minimum(2 * coarse_weights, np.float32(1))), columns, rows)
    return np.asarray(values * weights + around * (1 - weights), dtype=np.float32)


def _grid(width: int, height: int) -> tuple[int, int]:
    """Columns and rows of the grid over a picture: never finer than the picture."""
    columns = min(GRID_CELLS, width)
    return columns, max(1, min(height, round(height * columns / width)))


def _thinned(picture: F32) -> F32:
    """Every so many pixels and rows of a picture [H, W] or [H, W, 3], so that about two a cell and axis stay."""
    step = max(1, picture.shape[1] // (2 * GRID_CELLS))
    return np.ascontiguousarray(picture[step // 2 :: step, step // 2 :: step])


def _averaged(picture: F32, columns: int, rows: int) -> F32:
    return np.asarray(cv2.resize(picture, (columns, rows), interpolation=cv2.INTER_AREA), dtype=np.float32)


def _resized(picture: F32, width: int, height: int) -> F32:
    return np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_LINEAR), dtype=np.float32)


def _window(picture: F32) -> F32:
    size = (WINDOW_CELLS, WINDOW_CELLS)
    return np.asarray(cv2.blur(picture, size, borderType=cv2.BORDER_REFLECT), dtype=np.float32)


def _rms(difference: F32) -> F32:
    """Root of the windowed mean power [h, w] of ``difference`` [h, w, 3]."""
    power = np.maximum(_window(_over_channels(difference * difference)), 0)
    return np.asarray(np.sqrt(power / np.float32(3)), dtype=np.float32)


def _over_channels(picture: F32) -> F32:
    """Sum [h, w] of the three channels of [h, w, 3]; a reduction over so short an axis takes ten times as long."""
    return np.asarray(picture[..., 0] + picture[..., 1] + picture[..., 2], dtype=np.float32)
