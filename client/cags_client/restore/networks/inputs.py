"""What networks see of a frame, made with NumPy and OpenCV."""

from __future__ import annotations

import cv2
import numpy as np

from cags_common.geometry import F32
from cags_common.video.noise import CodingNoise

_REACH_CELLS = 5

_NO_NOISE = 1e-9
"""Variance that stands for none."""


def noise_features(noise: CodingNoise | F32) -> F32:
    """The six numbers [..., 6] of coding noise (fine, broad) as a network takes them: decades above 1e-4."""
    numbers = np.array([*noise.fine, *noise.broad]) if isinstance(noise, CodingNoise) else noise
    return np.asarray(np.log10(numbers + _NO_NOISE) + 4.0, dtype=np.float32)


def even(image: F32) -> F32:
    """``image`` [h, w, C] with its last row and column repeated where their number is odd."""
    h, w = image.shape[:2]
    return np.pad(image, ((0, h % 2), (0, w % 2), (0, 0)), mode="edge") if h % 2 or w % 2 else image


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
