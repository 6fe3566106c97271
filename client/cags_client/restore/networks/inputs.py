"""What networks see of a frame, made with NumPy and OpenCV.

Like is compared with like: the reference is set against the client's own splats, seen from the reference's pose through
the client's footprint (``RestoreInput.own``). The difference is *evidence* of wrong colour, free of parallax and of
pixel sizes; it is sampled at the client's pixels, at half their resolution, where nothing of it is lost.
"""

from __future__ import annotations

import cv2
import numpy as np

from cags_client.align.fast import sample
from cags_client.restore.affine import average_down
from cags_client.restore.base import RestoreInput
from cags_common.geometry import F32

HALF = 2
"""Client pixels a side of the cells that ``lite`` looks at."""

MULTIPLE_PX = 8
"""Sides are padded to a multiple of this: the coarsest resolution inside ``lite``."""

CHANNELS = 7
"""Distorted RGB, evidence RGB, confidence."""

_REACH_CELLS = 5


def half_features(inputs: RestoreInput) -> F32:
    """Input of ``lite`` [h, w, 7] at half resolution, h and w multiples of 4, for the picture padded by its edges."""
    aligned = inputs.aligned
    distorted, sure = padded(inputs.distorted), padded(aligned.confidence, zero=True)
    h, w = distorted.shape[0] // HALF, distorted.shape[1] // HALF
    x, y = (padded(c)[::HALF, ::HALF] for c in (aligned.x, aligned.y))
    out = np.empty((h, w, CHANNELS), np.float32)
    out[..., :3] = _area(distorted, w, h)
    out[..., 3:6] = sample(_evidence(inputs), x, y)
    out[..., 3:6] *= (sure[::HALF, ::HALF] > 0)[..., None]
    out[..., 6] = _area(sure, w, h)
    return out


def _evidence(inputs: RestoreInput) -> F32:
    """What the reference shows minus what the client's splats show there, [H, W, 3] of the reference."""
    aligned, reference = inputs.aligned, inputs.reference.rgb
    if inputs.own is None:
        own = average_down(inputs.distorted, aligned.x, aligned.y, aligned.confidence, reference)
    else:
        own = np.clip(inputs.own.rgb, 0.0, 1.0)
    return np.asarray(reference - own, dtype=np.float32)


def filled(aligned: F32, confidence: F32, distorted: F32) -> F32:
    """The aligned reference [..., H, W, 3] with the distorted picture where it says nothing at all.

    Occluded pixels that alignment filled from clean neighbours are kept.
    """
    silent = (confidence <= 0) & (aligned.max(axis=-1) <= 0)
    return np.where(silent[..., None], distorted, aligned)


def reach(confidence: F32) -> F32:
    """How far a correction may go [H, W]: the confidence, spread by about two reference pixels and smoothed."""
    h, w = confidence.shape
    cells = _area(confidence, max(1, w // 4), max(1, h // 4))
    spread = cv2.blur(cv2.dilate(cells, np.ones((_REACH_CELLS, _REACH_CELLS), np.uint8)), (3, 3))
    return np.asarray(cv2.resize(spread, (w, h), interpolation=cv2.INTER_LINEAR), dtype=np.float32).reshape(h, w)


def padded(image: F32, *, zero: bool = False) -> F32:
    """``image`` [H, W, ...] with its last row and column repeated (or zeros) up to multiples of 8."""
    h, w = image.shape[:2]
    extra = ((0, -h % MULTIPLE_PX), (0, -w % MULTIPLE_PX)) + ((0, 0),) * (image.ndim - 2)
    if not any(after for _, after in extra):
        return image
    return np.pad(image, extra) if zero else np.pad(image, extra, mode="edge")


def _area(image: F32, width: int, height: int) -> F32:
    shrunk = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(shrunk, dtype=np.float32).reshape(height, width, *image.shape[2:])
