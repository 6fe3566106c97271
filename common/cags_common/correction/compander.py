"""The compander of differences: odd, fine around zero, and with a zero that 8-bit video preserves exactly.

A difference d in [-1, 1] is coded as ``ZERO + SPAN asinh(d / knee) / asinh(1 / knee)``. ``ZERO`` is the colour that
limited-range luma 126 with neutral chroma decodes to (BT.709, :mod:`cags_common.video.colour`). Zero difference is
Y = 126, Cb = Cr = 128 in the video, and the client adds exactly nothing.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32, F64

ZERO = 110 / 219
"""Code of zero difference."""

SPAN = 109 / 219
"""Range of codes from zero to the largest difference."""

STILL = 1e-5
"""Codes this close to :data:`ZERO` decode to zero: the rounding of colour conversion, 1/400 of a luma level."""

STEPS = (1 << 15) - 1
"""Entries of the table on each side of zero, far more than 8 bits distinguish."""

KEPT_TABLES = 8


def compand(lack: NDArray[np.floating], knee: float) -> F64:
    """Code differences, clipped to [-1, 1], in [1 / 219, 1]; zero is :data:`ZERO`. ``knee`` is in (0, inf)."""
    within = np.clip(np.asarray(lack, np.float64), -1.0, 1.0)
    return np.asarray(ZERO + SPAN / np.arcsinh(1 / knee) * np.arcsinh(within / knee))


def expand(coded: NDArray[np.floating], knee: float) -> F64:
    """Inverse of :func:`compand`: a difference in [-1, 1], exactly 0 within :data:`STILL` of :data:`ZERO`."""
    away = np.asarray(coded, np.float64) - ZERO
    turned = np.clip(away / SPAN, -1.0, 1.0) * np.arcsinh(1 / knee)
    return np.where(np.abs(away) <= STILL, 0.0, np.sinh(turned) * knee)


def compand_by_table(lack: F32, knee: float) -> F32:
    """:func:`compand` of differences in [-1, 1] by a table, in a sixth of the time."""
    steps = np.rint(lack * np.float32(STEPS) + np.float32(STEPS)).astype(np.uint16)
    return np.asarray(_table(knee).take(steps))


@lru_cache(maxsize=KEPT_TABLES)
def _table(knee: float) -> F32:
    return compand(np.arange(-STEPS, STEPS + 1) / STEPS, knee).astype(np.float32)
