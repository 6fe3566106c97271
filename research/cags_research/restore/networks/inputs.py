"""What networks see of a frame, made with NumPy and OpenCV."""

from __future__ import annotations

import cv2
import numpy as np

from cags_common.geometry import F32

_REACH_CELLS = 5


def filled(aligned: F32, confidence: F32, distorted: F32) -> F32:
    """The aligned reference [..., H, W, 3] with the distorted picture where it says nothing at all.

    Occluded pixels that alignment filled from clean neighbours are kept.
    """
    silent = (confidence <= 0) & (aligned.max(axis=-1) <= 0)
    return np.where(silent[..., None], distorted, aligned)


def reach(confidence: F32) -> F32:
    """How far a correction may go [H, W]: the confidence, spread by about two reference pixels and smoothed."""
    h, w = confidence.shape
    cells = cv2.resize(confidence, (max(1, w // 4), max(1, h // 4)), interpolation=cv2.INTER_AREA)
    spread = cv2.blur(cv2.dilate(cells, np.ones((_REACH_CELLS, _REACH_CELLS), np.uint8)), (3, 3))
    return np.asarray(cv2.resize(spread, (w, h), interpolation=cv2.INTER_LINEAR), dtype=np.float32).reshape(h, w)
