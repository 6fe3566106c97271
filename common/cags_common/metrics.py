"""Image quality as the 3D Gaussian splatting papers measure it: PSNR and SSIM over display-referred RGB in [0, 1].

:func:`flicker` adds what single pictures cannot show: how steady a video's error is.

PSNR is capped at :data:`MAX_PSNR_DB`, so that averages over frames and JSON records stay finite where two pictures
are equal. ``covered`` variants look at the pixels that the scene covers alone: void background is equal in every
picture and would flatter all of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32

MAX_PSNR_DB = 100.0
"""PSNR of equal pictures."""

COVERED_ALPHA = 0.5
"""A pixel is covered where the truth's alpha is at least this."""

SSIM_WINDOW_PX = 11
SSIM_SIGMA_PX = 1.5
SSIM_C1 = 0.01**2
SSIM_C2 = 0.03**2

STRIP_PX = 64
"""Rows of a strip: at 1600 pixels a row, 600 kB."""


def psnr(picture: F32, truth: F32, mask: NDArray[np.bool_] | None = None) -> float:
    """Peak signal-to-noise ratio in dB over all pixels, or over those of ``mask`` [H, W].

    Both pictures are [H, W, 3]; ``picture`` is clipped to [0, 1] as a display would. An empty mask gives the cap: there
    was nothing to get wrong. Raises ``ValueError`` for pictures of different shapes.
    """
    whole, masked = psnr_also_in(picture, truth, mask)
    return whole if mask is None else masked


def psnr_also_in(picture: F32, truth: F32, mask: NDArray[np.bool_] | None) -> tuple[float, float]:
    """:func:`psnr` over all pixels and over those of ``mask`` [H, W] (None: over all again), in one pass."""
    _check(picture, truth)
    total = inside = 0.0
    for rows in _strips(picture.shape[0]):
        shown, true = _displayed(picture[rows]), _displayed(truth[rows])
        total += cv2.norm(shown, true, cv2.NORM_L2SQR)
        if mask is not None:
            inside += cv2.norm(shown, true, cv2.NORM_L2SQR, mask[rows].astype(np.uint8))
    whole = _decibels(total, picture.shape[0] * picture.shape[1])
    return whole, whole if mask is None else _decibels(inside, int(np.count_nonzero(mask)))


def _decibels(squares: float, pixels: int) -> float:
    mse = squares / (3 * pixels) if pixels else 0.0
    return MAX_PSNR_DB if mse <= 10 ** (-MAX_PSNR_DB / 10) else -10.0 * math.log10(mse)


def covered_mask(truth_alpha: F32) -> NDArray[np.bool_]:
    """Pixels [H, W] that the scene covers, from the alpha of the true picture."""
    return np.asarray(truth_alpha >= COVERED_ALPHA)


def ssim_map(picture: F32, truth: F32) -> F32:
    """Structural similarity [H, W, 3] a pixel and channel (Wang et al. 2004), as in the 3DGS papers' code.

    Gaussian window of 11 x 11, sigma 1.5, **zero padding** at the borders, biased variances.
    """
    _check(picture, truth)
    out = np.empty(picture.shape, np.float32)
    for rows in _strips(picture.shape[0]):
        around = slice(max(rows.start - SSIM_WINDOW_PX // 2, 0), rows.stop + SSIM_WINDOW_PX // 2)
        inner = slice(rows.start - around.start, rows.stop - around.start)
        out[rows] = _similarity(_displayed(picture[around]), _displayed(truth[around]))[inner]
    return out


def _similarity(x: F32, y: F32) -> F32:
    """:func:`ssim_map` of rows that are padded by zeros."""

    def blur(image: F32) -> F32:
        size = (SSIM_WINDOW_PX, SSIM_WINDOW_PX)
        blurred = cv2.GaussianBlur(image, size, SSIM_SIGMA_PX, borderType=cv2.BORDER_CONSTANT)
        return np.asarray(blurred, dtype=np.float32).reshape(image.shape)

    mean_x, mean_y = blur(x), blur(y)
    cov = blur(x * y)
    both = mean_x * mean_y
    cov -= both
    squares = mean_x * mean_x
    squares += mean_y * mean_y
    variances = blur(x * x + y * y)
    variances -= squares
    numerator = (2 * both + SSIM_C1) * (2 * cov + SSIM_C2)
    squares += SSIM_C1
    variances += SSIM_C2
    squares *= variances
    numerator /= squares
    return numerator


def ssim(picture: F32, truth: F32, mask: NDArray[np.bool_] | None = None) -> float:
    """Mean of :func:`ssim_map` over the picture, or over the pixels of ``mask`` [H, W] (1.0 for an empty mask)."""
    values = ssim_map(picture, truth)
    if mask is not None:
        values = values[mask]
    return float(np.mean(values, dtype=np.float64)) if values.size else 1.0


def flicker(picture: F32, before: F32, truth: F32, truth_before: F32) -> float:
    """How much the error of a video changes from one frame to the next, RMS in steps of 1/255; 0 for a steady error.

    All are [H, W, 3]: a frame, the one before, and what they should have been. The motion of the scene and of the
    camera is in both differences and cancels; what is left is what the eye sees flicker: corrections that come and go,
    layers that pop in, noise of the reference.
    """
    _check(picture, truth)
    _check(before, truth_before)
    _check(picture, before)
    total = 0.0
    for rows in _strips(picture.shape[0]):
        now, then = _displayed(picture[rows]), _displayed(before[rows])
        now -= _displayed(truth[rows])
        then -= _displayed(truth_before[rows])
        total += cv2.norm(now, then, cv2.NORM_L2SQR)
    return 255.0 * math.sqrt(total / max(picture.size, 1))


def _displayed(picture: F32) -> F32:
    """A picture as a display shows it, in an array of its own."""
    shown: F32 = np.clip(picture, np.float32(0.0), np.float32(1.0), dtype=np.float32)
    return shown


def _strips(height: int) -> Iterator[slice]:
    """Rows, some at a time: what a metric works with between two of its steps stays in the processor's cache."""
    for top in range(0, height, STRIP_PX):
        yield slice(top, min(top + STRIP_PX, height))


def _check(picture: F32, truth: F32) -> None:
    if picture.shape != truth.shape or picture.ndim != 3 or picture.shape[2] != 3:
        raise ValueError(f"pictures of shapes {picture.shape} and {truth.shape}; give two [H, W, 3] of one size")
