"""Noise of the source, which motion must not tell: coarse codes of rotations shake what turns evenly."""

from __future__ import annotations

from functools import cache

import numpy as np

from cags_common.geometry import F64

LEAST_FRAMES = 5
"""Fewer samples do not tell noise from motion."""

LEAST_NOISE = 0.03
"""Noise below so many finest units costs next to nothing."""

SHARE = 1.5
"""Smoothing takes away at most so many times the noise, in the root mean square."""

STRENGTHS = (1.0, 10.0, 100.0, 1e3, 1e4)
HELD = 1e6
"""Weight of a first sample that stays."""

_FOURTH = 70.0
"""Sum of the squares of (1, -4, 6, -4, 1): how much of white noise is in fourth differences."""


def smoothed(values: F64, most: float, *, starts: bool) -> F64:
    """``values`` [frames, n, c] in finest units without the noise that their fourth differences tell.

    Each splat is as smooth as its noise, and ``most`` units of change, allow: Whittaker's smoothing (1923) by second
    differences, its strength by the discrepancy.

    Without ``starts`` the first sample is nothing, and nothing it stays.
    """
    if len(values) < LEAST_FRAMES:
        return values
    noise = np.sqrt(np.square(np.diff(values, 4, axis=0)).mean(axis=(0, 2)) / _FOURTH)
    rows = np.flatnonzero(noise > LEAST_NOISE)
    noisy, limit = values[:, rows], SHARE * noise[rows]
    chosen = noisy.copy()
    for strength in STRENGTHS:
        tried = np.einsum("ft,tnc->fnc", _smoother(len(values), strength, starts), noisy)
        off = tried - noisy
        fine = np.sqrt(np.square(off).mean(axis=(0, 2))) <= limit
        fine &= np.abs(off).max(axis=(0, 2), initial=0.0) <= most
        chosen = np.where(fine[:, None], tried, chosen)
    out = values.copy()
    out[:, rows] = chosen
    return out


@cache
def _smoother(frames: int, strength: float, starts: bool) -> F64:
    """[frames, frames] samples to smooth ones."""
    bends = np.diff(np.eye(frames), 2, axis=0)
    weights = np.diag(np.where(np.arange(frames) == 0, 1.0 if starts else HELD, 1.0))
    matrix: F64 = np.linalg.solve(weights + strength * bends.T @ bends, weights)
    return matrix
