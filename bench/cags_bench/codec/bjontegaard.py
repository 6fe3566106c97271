"""Bjontegaard differences of two rate-distortion curves (ITU-T VCEG-M33), with monotone cubic interpolation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import PchipInterpolator

Curve = Sequence[tuple[float, float]]
"""(rate, quality in dB) points."""


def bd_psnr_db(curve: Curve, anchor: Curve) -> float | None:
    """Mean gain of ``curve`` over ``anchor`` in dB at equal rate, over their common rates; None if there are none."""
    ours, theirs = _rising(curve), _rising(anchor)
    low, high = max(ours[0][0], theirs[0][0]), min(ours[0][-1], theirs[0][-1])
    return _mean_difference(ours, theirs, low, high)


def bd_rate(curve: Curve, anchor: Curve) -> float | None:
    """Mean change of rate at equal quality (-0.35: 35 % fewer bytes), over their common qualities."""
    ours, theirs = _rising(curve)[::-1], _rising(anchor)[::-1]
    low, high = max(ours[0][0], theirs[0][0]), min(ours[0][-1], theirs[0][-1])
    change = _mean_difference(ours, theirs, low, high)
    return None if change is None else float(np.exp(change) - 1)


def _rising(curve: Curve) -> tuple[np.ndarray, np.ndarray]:
    """Logarithms of rates, and qualities, without points that cost more but are no better."""
    kept: list[tuple[float, float]] = []
    for rate, quality in sorted(curve):
        if not kept or (rate > kept[-1][0] and quality > kept[-1][1]):
            kept.append((rate, quality))
    rates, qualities = np.array(kept).T
    return np.log(rates), qualities


def _mean_difference(
    ours: tuple[np.ndarray, np.ndarray], theirs: tuple[np.ndarray, np.ndarray], low: float, high: float
) -> float | None:
    if high <= low or len(ours[0]) < 2 or len(theirs[0]) < 2:
        return None
    area = [float(PchipInterpolator(*curve).integrate(low, high)) for curve in (ours, theirs)]
    return (area[0] - area[1]) / (high - low)
