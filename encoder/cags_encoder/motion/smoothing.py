"""Removes noise of the source from motion: coarsely quantised rotations jitter although the splat turns evenly."""

from __future__ import annotations

from functools import cache

import numpy as np

from cags_common.geometry import F64

LEAST_FRAMES = 5
"""With fewer samples, noise and motion cannot be separated."""

LEAST_NOISE = 0.03
"""Less noise, in finest units, costs almost nothing."""

SHARE = 1.5
"""Largest root mean square change by smoothing, as a multiple of the noise."""

STRENGTHS = (1.0, 10.0, 100.0, 1e3, 1e4)
HELD = 1e6
"""Weight of a first sample that must not change."""

_FOURTH = 70.0
"""Sum of the squares of (1, -4, 6, -4, 1): the gain of fourth differences for the variance of white noise."""


def smoothed(values: F64, most: float, *, starts: bool) -> F64:
    """``values`` [frames, n, c], in finest units, without the noise that their fourth differences show.

    Whittaker smoothing (1923) by second differences. Each splat gets the largest strength whose change stays below
    :data:`SHARE` times its noise (discrepancy principle) and below ``most`` units.

    Unless ``starts``, the first sample is zero and stays zero.
    """
    if len(values) < LEAST_FRAMES:
        return values
    noise = np.sqrt(np.square(np.diff(values, 4, axis=0)).mean(axis=(0, 2)) / _FOURTH)
    rows = np.flatnonzero(noise > LEAST_NOISE)
    noisy, limit = values[:, rows], SHARE * noise[rows]
    chosen = noisy.copy()
    for strength in STRENGTHS:
        tried = np.einsum("ft,tnc->fnc", _smoother(len(values), strength, starts), noisy)
        change = tried - noisy
        fine = np.sqrt(np.square(change).mean(axis=(0, 2))) <= limit
        fine &= np.abs(change).max(axis=(0, 2), initial=0.0) <= most
        chosen = np.where(fine[:, None], tried, chosen)
    out = values.copy()
    out[:, rows] = chosen
    return out


@cache
def _smoother(frames: int, strength: float, starts: bool) -> F64:
    """Matrix [frames, frames] from samples to smoothed samples."""
    differences = np.diff(np.eye(frames), 2, axis=0)
    weights = np.diag(np.where(np.arange(frames) == 0, 1.0 if starts else HELD, 1.0))
    matrix: F64 = np.linalg.solve(weights + strength * differences.T @ differences, weights)
    return matrix
