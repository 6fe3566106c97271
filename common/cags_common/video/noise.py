"""What coding did to a picture, in six numbers: enough for a receiver to tell its own errors from the codec's.

Coding errors follow two laws (three scenes, crf 14 to 27, both chroma formats). Averaged over a 5 x 5 window the error
hardly depends on what is there. What is left of it in the window has a variance that grows as the *square root* of the
picture's own variance, because a transform coder keeps strong coefficients to its step and loses the weak ones. Each
law needs one factor a component; whoever has both pictures measures it, whoever has only the coded one applies it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32
from cags_common.video.colour import BLACK_CODES, CODE_SPANS, rgb_of_ycbcr, ycbcr_of_rgb

YCC_OF_RGB = np.array([[0.2126, 0.7152, 0.0722], [-0.114572, -0.385428, 0.5], [0.5, -0.454153, -0.045847]], np.float32)
"""Luma and chromas of display-referred RGB (BT.709) in units of the full range."""

WINDOW_PX = 5
VOID_POWER = 1e-4
"""Mean square luma of a window below which it counts as void."""

ROW_STEP, LEAST_ROWS = 3, 30
"""Of a picture of at least so many rows of windows, every third is measured: a third of the time."""

_FINE_UNIT, _BROAD_UNIT = 1e-6, 1e-9
LARGEST_CODE = 1_000_000
"""Of a packed number: a variance of 1e-3, a fine factor of 1."""

Components = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class CodingNoise:
    """Error of a coded picture in luma, Cb and Cr (:data:`YCC_OF_RGB`)."""

    fine: Components = (2e-3, 8e-3, 8e-3)
    """Variance within a window, as a factor on the square root of the picture's own variance there."""
    broad: Components = (1.5e-5, 5e-5, 5e-5)
    """Variance of the window's mean. The defaults are those of H.264 at crf 20."""

    def packed(self) -> tuple[int, ...]:
        """Six small integers for the wire: fine in 1e-6, broad in 1e-9."""
        numbers = [value / _FINE_UNIT for value in self.fine] + [value / _BROAD_UNIT for value in self.broad]
        return tuple(min(max(round(number), 0), LARGEST_CODE) for number in numbers)

    @classmethod
    def of_packed(cls, numbers: tuple[int, ...]) -> CodingNoise:
        """The inverse of :meth:`packed`; anything but six numbers gives the defaults."""
        if len(numbers) != 6:
            return cls()
        a, b, c, d, e, f = numbers
        return cls(
            (a * _FINE_UNIT, b * _FINE_UNIT, c * _FINE_UNIT), (d * _BROAD_UNIT, e * _BROAD_UNIT, f * _BROAD_UNIT)
        )


def coding_noise(original: F32, coded: F32) -> CodingNoise:
    """Measured over the covered part of ``original`` [H, W, 3] (over black), both in [0, 1].

    The defaults where all is void.
    """
    original, coded = _sampled(original), _sampled(coded)
    return _measured(_ycc(original), _ycc(coded - original), np.ones(3))


def coding_noise_of_ycbcr(original: F32, coded: F32) -> CodingNoise:
    """As :func:`coding_noise`, of YCbCr codes [H, W, 3] (:mod:`~cags_common.video.colour`): cheaper for an encoder.

    Codes that no display shows are brought to the nearest colour first, as a receiver does: on saturated colours that
    moves errors from within a window to its mean, by a factor of 2.5 in Cb.
    """
    original, coded = _sampled(original), ycbcr_of_rgb(rgb_of_ycbcr(_sampled(coded)))
    black: Any = (*BLACK_CODES, 0.0)  # a scalar to OpenCV: numpy takes ten times as long to spread it over the pixels
    ycc = np.asarray(cv2.subtract(original, black), dtype=np.float32)
    return _measured(ycc, coded - original, 1.0 / np.array(CODE_SPANS))


def _measured(ycc: F32, error: F32, unit: NDArray[np.float64]) -> CodingNoise:
    """Of components [H, W, 3] in steps of ``unit`` [3]: only the means are brought to it, full pictures cost more."""
    mean, mean_square = _mean(ycc) * unit, _mean(ycc * ycc) * unit**2
    broad = np.square(_mean(error) * unit)
    fine = np.maximum(_mean(error * error) * unit**2 - broad, 0)
    deviation = np.sqrt(np.maximum(mean_square - mean * mean, 0))
    shown = mean_square[..., 0] > VOID_POWER
    if not shown.any():
        return CodingNoise()
    share = fine[shown].sum(axis=0) / np.maximum(deviation[shown].sum(axis=0), 1e-6)
    (a, b, c), (d, e, f) = (values.astype(float).tolist() for values in (share, broad[shown].mean(axis=0)))
    return CodingNoise((a, b, c), (d, e, f))


def _sampled(image: F32) -> F32:
    """Every :data:`ROW_STEP`-th row of windows: six means over a thousand windows are known well enough."""
    height, width = image.shape[:2]
    rows = height // WINDOW_PX
    if rows < LEAST_ROWS:
        return image
    windows = image[: rows * WINDOW_PX].reshape(rows, WINDOW_PX, width, 3)[::ROW_STEP]
    return np.ascontiguousarray(windows).reshape(-1, width, 3)


def _ycc(rgb: F32) -> F32:
    return np.asarray(cv2.transform(rgb, YCC_OF_RGB), dtype=np.float32)


def _mean(image: F32) -> NDArray[np.float32]:
    """Means over whole windows that lie side by side: overlapping ones say the same at five times the cost."""
    height, width = (side // WINDOW_PX * WINDOW_PX or side for side in image.shape[:2])
    size = (max(width // WINDOW_PX, 1), max(height // WINDOW_PX, 1))
    mean = cv2.resize(image[:height, :width], size, interpolation=cv2.INTER_AREA)
    return np.asarray(mean, dtype=np.float32).reshape(*size[::-1], -1)
