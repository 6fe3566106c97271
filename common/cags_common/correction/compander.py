"""The compander of differences: fine about none, odd, and with a none that survives 8-bit video exactly.

A difference d in [-1, 1] is coded as ``ZERO + SPAN asinh(d / knee) / asinh(1 / knee)``. ``ZERO`` is what luma 126 of
limited range with neutral chroma decodes to (BT.709, :mod:`cags_common.video.colour`): where nothing is lacking the
video holds Y = 126, Cb = Cr = 128, and the client adds exactly nothing.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32, F64

ZERO = 110 / 219
"""What no difference is coded as."""

SPAN = 109 / 219
"""From no difference to the largest."""

STILL = 1e-5
"""Codes no further from :data:`ZERO` are none: the rounding of colour conversion, a 400th of a level of luma."""

STEPS = (1 << 15) - 1
"""Differences that a table tells apart, on either side of none: far more than 8 bits hold."""

KEPT_TABLES = 8


def compand(lack: NDArray[np.floating], knee: float) -> F64:
    """A difference in [-1, 1] (beyond: clipped) in [1 / 219, 1]; :data:`ZERO` is none. ``knee`` is in (0, inf)."""
    within = np.clip(np.asarray(lack, np.float64), -1.0, 1.0)
    return np.asarray(ZERO + SPAN / np.arcsinh(1 / knee) * np.arcsinh(within / knee))


def expand(coded: NDArray[np.floating], knee: float) -> F64:
    """:func:`compand` undone: a difference in [-1, 1]; exactly 0 within :data:`STILL` of none."""
    away = np.asarray(coded, np.float64) - ZERO
    turned = np.clip(away / SPAN, -1.0, 1.0) * np.arcsinh(1 / knee)
    return np.where(np.abs(away) <= STILL, 0.0, np.sinh(turned) * knee)


def compand_by_table(lack: F32, knee: float) -> F32:
    """:func:`compand` of differences in [-1, 1], by a table: a sixth of the time."""
    steps = np.rint(lack * np.float32(STEPS) + np.float32(STEPS)).astype(np.uint16)
    return np.asarray(_table(knee).take(steps))


@lru_cache(maxsize=KEPT_TABLES)
def _table(knee: float) -> F32:
    return compand(np.arange(-STEPS, STEPS + 1) / STEPS, knee).astype(np.float32)
