"""Fades: opacity as a Gaussian over time, as in 4D models."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F64
from cags_common.motion.chunk import FADE_STEP, FADE_WIDTHS

LEAST_CHANGE = 0.06
"""Least change of drawn opacity over a life for which a fade is fitted."""

WORST_FIT = 0.06
"""Largest root mean square error of drawn opacity of a fade."""

SEARCHED = 3
"""Number of smaller and of larger widths that are tried if the first fit is poor."""

FURTHEST = 2000
"""Largest distance of a centre from the middle of a life, in steps of the centre."""

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


def changing(opacities: F64, present: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which splats [n] have different ``opacities`` [frames, n] where they are ``present``, from the first frame on."""
    varies: NDArray[np.bool_] = (present & (opacities != opacities[0])).any(axis=0)
    return varies


def fit_fades(
    opacities: F64, present: NDArray[np.bool_], peak: F64, middles: F64
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Fades [n, 2] of ``opacities`` [frames, n] where ``present``, below ``peak`` [n]: index of the width plus one (0:
    none) and the centre, in parts of the width from ``middles`` [n]. And which of the splats they describe well enough
    [n]; those without a fade by being even.

    The fit of a line is wrong where the largest sample is on the other side of the centre than assumed, or where
    rounding the width shifts the flank. Widths and centres around such fits are searched.
    """
    times = np.arange(len(opacities), dtype=np.float64)[:, None]
    count = np.maximum(present.sum(axis=0), 1)
    even = _error(np.broadcast_to(peak, opacities.shape), opacities, present, count)
    width, centre = _lines(opacities, present, peak, times)
    index = np.clip(np.rint((np.log2(np.clip(width, 1e-3, 1e9)) + 3) * 4), 0, len(FADE_WIDTHS) - 1).astype(np.int64)
    part = np.clip(np.rint((centre - middles) * FADE_STEP / FADE_WIDTHS[index]), -FURTHEST, FURTHEST).astype(np.int64)
    faded = _error(_gaussian(index, part, middles, peak, times), opacities, present, count)
    chosen = np.stack([index, part], axis=1)
    poor = np.flatnonzero((even > LEAST_CHANGE / 2) & ~_describes(faded, even))
    some = (opacities[:, poor], present[:, poor], count[poor])
    for wider in range(-SEARCHED, SEARCHED + 1):
        at = np.clip(index[poor] + wider, 0, len(FADE_WIDTHS) - 1)
        nearest = np.rint((centre[poor] - middles[poor]) * FADE_STEP / FADE_WIDTHS[at])
        for later in range(-FADE_STEP - 2, FADE_STEP + 3):
            to = np.clip(nearest + later, -FURTHEST, FURTHEST).astype(np.int64)
            tried = _error(_gaussian(at, to, middles[poor], peak[poor], times), *some)
            better = tried < faded[poor]
            rows = poor[better]
            faded[rows], chosen[rows] = tried[better], np.stack([at, to], axis=1)[better]
    use = (even > LEAST_CHANGE / 2) & _describes(faded, even)
    chosen[:, 0] += 1
    chosen[~use] = 0
    return chosen, np.where(use, faded, even) < WORST_FIT


def _describes(faded: F64, even: F64) -> NDArray[np.bool_]:
    """Whether a fade's error [n] is tolerable, and well below that of an ``even`` opacity."""
    fine: NDArray[np.bool_] = (faded < 0.7 * even) & (faded < WORST_FIT)
    return fine


def _gaussian(index: NDArray[np.int64], part: NDArray[np.int64], middles: F64, peak: F64, times: F64) -> F64:
    """Opacities [frames, n] of fades."""
    width = FADE_WIDTHS[index]
    opacities: F64 = np.exp(-0.5 * np.square((times - (middles + part * width / FADE_STEP)) / width)) * peak
    return opacities


def _error(guess: F64, opacities: F64, present: NDArray[np.bool_], count: NDArray[np.int64]) -> F64:
    """Root mean square error [n] of ``guess`` [frames, n] where ``present``."""
    root: F64 = np.sqrt(np.where(present, np.square(opacities - guess), 0.0).sum(axis=0) / count)
    return root


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
    slope = np.where(present.sum(axis=0) == 1, 1.0, np.maximum(slope, 1e-9))  # one sample fits any width
    return 1.0 / slope, np.clip(mean_t - mean_r / slope, -1e6, 1e6)
