"""Half resolution: cameras with half the width and height, and pictures enlarged to full size."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

import cags_kernels
from cags_common.geometry import F32, Camera, Intrinsics


def halved(camera: Camera) -> Camera:
    """The same view with half the width and height, rounded up; all pixels keep one size."""
    i = camera.intrinsics
    width, height = (i.width_px + 1) // 2, (i.height_px + 1) // 2
    return replace(camera, intrinsics=Intrinsics(width, height, i.fx_px / 2, i.fy_px / 2, i.cx_px / 2, i.cy_px / 2))


def enlarged(picture: F32, whole: Camera, threads: int) -> F32:
    """Enlarge ``picture`` [h, w, 3] of the :func:`halved` camera by cubic convolution (Keys 1981, a = -3/4).

    Returns [H, W, 3] for camera ``whole``; both lie in [0, 1]. Raises ``ValueError`` for a picture of another size.
    """
    width, height = whole.width_px, whole.height_px
    if cags_kernels.native_available():
        from cags_kernels.raster import enlarge

        return enlarge(picture, width, height, threads)
    if picture.shape != ((height + 1) // 2, (width + 1) // 2, 3):
        raise ValueError(f"picture of shape {picture.shape} is not half of {width}x{height} px")
    size = 2 * picture.shape[1], 2 * picture.shape[0]
    large = cv2.resize(picture, size, interpolation=cv2.INTER_CUBIC)[:height, :width]
    return np.asarray(np.clip(large, 0.0, 1.0), dtype=np.float32)
