"""Means over the window of the closed form's local fit."""

from __future__ import annotations

import cv2
import numpy as np

from cags_common.geometry import F32

WINDOW_PX = 5
"""Its side."""


def local_mean(values: F32) -> F32:
    """[h, w], over the window around each pixel."""
    size = (WINDOW_PX, WINDOW_PX)
    return np.asarray(cv2.blur(values, size, borderType=cv2.BORDER_REFLECT), dtype=np.float32)


def correction_power(fields: F32, own: F32) -> F32:
    """[h, w] local power, over three channels in 0..1, of what ``fields`` [h, w, 4] change in ``own`` [h, w, 3]."""
    change = own * fields[..., :1] + fields[..., 1:]
    return local_mean(np.square(change).sum(axis=2))
