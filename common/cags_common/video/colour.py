"""RGB to the YCbCr planes that H.264 codes, and back: BT.709 matrix, limited range, chroma sited at the block's centre.

Both directions are defined here, so that encoder and decoder cannot disagree: a mismatch of matrix or range costs
5-16 dB. Chroma is averaged over its 2x2 block and read back by bilinear interpolation with half-pixel centres, which
keeps more of fine coloured detail than a library conversion that samples one corner of the block.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32

U8 = NDArray[np.uint8]

_KR, _KB = 0.2126, 0.0722
_LUMA = np.array([_KR, 1.0 - _KR - _KB, _KB])
_BLACK, _LUMA_SPAN, _CHROMA_ZERO, _CHROMA_SPAN = 16.0, 219.0, 128.0, 224.0


class Chroma(StrEnum):
    """How often colour is sampled; the value is FFmpeg's pixel format."""

    HALF = "yuv420p"
    """Once a 2x2 block: every decoder reads it; tops out near 39 dB on coloured detail."""
    FULL = "yuv444p"
    """At every pixel; larger, tops out near 52 dB."""


def _to_ycbcr() -> NDArray[np.float64]:
    rows = np.zeros((3, 4))
    rows[0, :3] = _LUMA * _LUMA_SPAN
    rows[1, :3] = (np.array([0.0, 0.0, 1.0]) - _LUMA) / (2 * (1 - _KB)) * _CHROMA_SPAN
    rows[2, :3] = (np.array([1.0, 0.0, 0.0]) - _LUMA) / (2 * (1 - _KR)) * _CHROMA_SPAN
    rows[:, 3] = (_BLACK, _CHROMA_ZERO, _CHROMA_ZERO)
    return rows


def _to_rgb(forward: NDArray[np.float64]) -> NDArray[np.float64]:
    inverse = np.linalg.inv(forward[:, :3])
    return np.concatenate([inverse, -inverse @ forward[:, 3:]], axis=1)


_FORWARD = _to_ycbcr()
_BACKWARD = _to_rgb(_FORWARD)


def ycbcr_of_rgb(rgb: NDArray[Any]) -> F32:
    """YCbCr [H, W, 3] float32 in 8-bit codes, not rounded, of an RGB image, float in [0, 1] (clipped) or uint8."""
    unit = rgb.astype(np.float32) / np.float32(255) if rgb.dtype == np.uint8 else np.clip(rgb, 0, 1, dtype=np.float32)
    return np.asarray(cv2.transform(np.ascontiguousarray(unit), _FORWARD), dtype=np.float32)


def rgb_of_ycbcr(ycbcr: F32) -> F32:
    """RGB [H, W, 3] float32 in [0, 1] of YCbCr codes."""
    rgb = np.asarray(cv2.transform(ycbcr, _BACKWARD), dtype=np.float32)
    return np.clip(rgb, 0.0, 1.0, out=rgb)


def planes_of_ycbcr(ycbcr: F32, chroma: Chroma) -> U8:
    """YCbCr codes [H, W, 3] rounded into FFmpeg's packed layout.

    [H * 3 / 2, W] for half chroma (H and W even), [3, H, W] for full chroma.
    """
    if chroma is Chroma.FULL:
        return np.stack(cv2.split(_rounded(ycbcr)))
    y, cb, cr = cv2.split(ycbcr)
    height, width = y.shape
    half = (width // 2, height // 2)
    small = [_rounded(cv2.resize(plane, half, interpolation=cv2.INTER_AREA)) for plane in (cb, cr)]
    return np.concatenate([_rounded(y).ravel(), small[0].ravel(), small[1].ravel()]).reshape(height * 3 // 2, width)


def ycbcr_of_planes(planes: U8, chroma: Chroma) -> F32:
    """YCbCr codes [H, W, 3] float32 of planes laid out as :func:`planes_of_ycbcr` lays them out."""
    if chroma is Chroma.FULL:
        return np.asarray(cv2.merge(list(planes)), dtype=np.float32)
    width = planes.shape[1]
    height = planes.shape[0] * 2 // 3
    flat = planes.reshape(-1)
    y = flat[: height * width].reshape(height, width).astype(np.float32)
    halves = flat[height * width :].reshape(2, height // 2, width // 2).astype(np.float32)
    cb, cr = (cv2.resize(half, (width, height), interpolation=cv2.INTER_LINEAR) for half in halves)
    return np.asarray(cv2.merge([y, cb, cr]), dtype=np.float32)


def _rounded(plane: NDArray[Any]) -> U8:
    return np.asarray(
        cv2.convertScaleAbs(plane), dtype=np.uint8
    )  # rounds and saturates; planes are never negative here
