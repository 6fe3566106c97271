"""Fades: opacity as a Gaussian over time, as in 4D models."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F64
from cags_common.motion.chunk import FADE_STEP, FADE_WIDTHS

LEAST_CHANGE = 0.06
"""Change of drawn opacity over a life from which on a fade is looked for."""

WORST_FIT = 0.06
"""Largest error of drawn opacity, in the root mean square, that a fade may leave."""

_LEAST = 1e-4


def peaks(opacities: F64, present: NDArray[np.bool_]) -> F64:
    """Largest opacity [n] of each life in ``opacities`` [frames, n].

    If the largest sample has neighbours, it is the vertex of the parabola through their logarithms.
    """
    logs = np.log(np.maximum(np.where(present, opacities, 0.0), _LEAST))
    top, rows = logs.argmax(axis=0), np.arange(logs.shape[1])
    inner = np.clip(top, 1, max(len(logs) - 2, 1))
    if len(logs) < 3:
        return _exp(logs[top, rows])
    left, middle, right = (logs[inner + i, rows] for i in (-1, 0, 1))
    whole = np.logical_and.reduce([present[inner + i, rows] for i in (-1, 0, 1)]) & (inner == top)
    bend = left - 2 * middle + right
    rise = np.where(whole & (bend < -1e-9), -np.square(right - left) / (8 * np.where(bend < -1e-9, bend, -1.0)), 0.0)
    return _exp(np.minimum(logs[top, rows] + np.minimum(rise, 0.25), np.log(0.9995)))


def _exp(values: F64) -> F64:
    out: F64 = np.exp(values)
    return out


def fit_fades(
    opacities: F64, present: NDArray[np.bool_], peak: F64, middles: F64
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Fades [n, 2] of ``opacities`` [frames, n] where ``present``, below ``peak`` [n]: index of the width plus one (0:
    none) and the centre, in parts of the width from ``middles`` [n]. And which of the splats they describe well enough
    [n]; those without a fade by being even.
    """
    times = np.arange(len(opacities), dtype=np.float64)[:, None]
    width, centre = _lines(opacities, present, peak, times)
    index = np.clip(np.rint((np.log2(np.clip(width, 1e-3, 1e9)) + 3) * 4), 0, len(FADE_WIDTHS) - 1).astype(np.int64)
    drawn_width = FADE_WIDTHS[index]
    part = np.clip(np.rint((centre - middles) * FADE_STEP / drawn_width), -2000, 2000).astype(np.int64)
    drawn = np.exp(-0.5 * np.square((times - (middles + part * drawn_width / FADE_STEP)) / drawn_width)) * peak
    count = np.maximum(present.sum(axis=0), 1)

    def error(guess: F64) -> F64:
        root: F64 = np.sqrt(np.where(present, np.square(opacities - guess), 0.0).sum(axis=0) / count)
        return root

    even, faded = error(np.broadcast_to(peak, opacities.shape)), error(drawn)
    fades = np.stack([index + 1, part], axis=1)
    use = (even > LEAST_CHANGE / 2) & (faded < 0.7 * even) & (faded < WORST_FIT)
    fades[~use] = 0
    return fades, np.where(use, faded, even) < WORST_FIT


def _vertex(opacities: F64, present: NDArray[np.bool_]) -> F64:
    """Time [n] at which the root of each exponent changes sign: half a frame from the largest sample, towards its
    larger neighbour. If the largest sample is at an end of the life, the centre lies beyond that end.
    """
    shown = np.where(present, opacities, -1.0)
    top, rows = shown.argmax(axis=0), np.arange(shown.shape[1])
    padded = np.concatenate([shown[:1] * 0 - 1.0, shown, shown[:1] * 0 - 1.0])
    left, right = padded[top, rows], padded[top + 2, rows]
    towards_right = np.where((left < 0) | (right < 0), right < 0, right > left)
    alone = (left < 0) & (right < 0)
    vertex: F64 = top + np.where(alone, 0.0, np.where(towards_right, 0.5, -0.5))
    return vertex


def _lines(opacities: F64, present: NDArray[np.bool_], peak: F64, times: F64) -> tuple[F64, F64]:
    """Widths and centres [n] by linear regression: the signed root of a Gaussian's exponent is linear in time."""
    share = np.clip(np.where(present, opacities, 1.0) / np.maximum(peak, _LEAST), 1e-6, 1.0)
    root = np.sqrt(-2.0 * np.log(share)) * np.where(times < _vertex(opacities, present), -1.0, 1.0)
    weights = np.where(present, np.square(opacities) + 1e-6, 0.0)
    total = np.maximum(weights.sum(axis=0), 1e-12)
    mean_t, mean_r = (weights * times).sum(axis=0) / total, (weights * root).sum(axis=0) / total
    slope = (weights * (times - mean_t) * (root - mean_r)).sum(axis=0)
    slope /= np.maximum((weights * np.square(times - mean_t)).sum(axis=0), 1e-12)
    slope = np.maximum(slope, 1e-9)
    return 1.0 / slope, np.clip(mean_t - mean_r / slope, -1e6, 1e6)
