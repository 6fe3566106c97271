"""Fades: opacities of splats that come and go as a Gaussian of the time.

Exponentials and logarithms of libraries differ in their last bits from processor to processor. Decoders that mirror
each other must not, so both are computed here by sums and products in a fixed order, which the kernel follows.
"""

from __future__ import annotations

import numpy as np

from cags_common.geometry import F32, F64

FAINTEST, STRONGEST = 1e-9, 1 - 1e-7
"""Opacities are held between these: their logits are finite."""

MOST_EXPONENT = 700.0
"""Exponents are held within +- this: beyond, results would not be normal numbers."""

_LOG2_E = 1.4426950408889634
_LN2 = 0.693147180369123816490, 1.90821492927058770002e-10  # a sum; multiples of the first up to 2**10 are exact
_ROUND = 6755399441055744.0  # 1.5 * 2**52: added and subtracted, it leaves the nearest whole number
_TAYLOR = tuple(1.0 / float(f) for f in (479001600, 39916800, 3628800, 362880, 40320, 5040, 720, 120, 24, 6, 2, 1, 1))
_ODD = tuple(1.0 / n for n in (21, 19, 17, 15, 13, 11, 9, 7, 5, 3, 1))
_HALF_ROOT = 0.7071067811865476


def faded(fades: F32, time: float, logits: F32) -> F32:
    """Opacity logits [n] at ``time``, of ``logits`` [n] before: opacities times a Gaussian of the time.

    ``fades`` [n, 2] are its centre and standard deviation, in the unit of the time; infinite for no fade.
    """
    rows = np.flatnonzero(np.isfinite(fades[:, 1]))
    if not len(rows):
        return logits
    away = (np.float64(time) - fades[rows, 0]) / fades[rows, 1].astype(np.float64)
    opacity = exponential(-0.5 * away * away) / (1.0 + exponential(-logits[rows].astype(np.float64)))
    inside = np.clip(opacity, FAINTEST, STRONGEST)
    out = logits.copy()
    out[rows] = logarithm(inside / (1.0 - inside)).astype(np.float32)
    return out


def exponential(values: F64) -> F64:
    """e to the power of ``values`` [n], held within +-:data:`MOST_EXPONENT`; to some 1e-15 of the result."""
    held = np.clip(values, -MOST_EXPONENT, MOST_EXPONENT)
    powers = (held * _LOG2_E + _ROUND) - _ROUND
    rest = (held - powers * _LN2[0]) - powers * _LN2[1]
    return np.ldexp(_polynomial(_TAYLOR, rest), powers.astype(np.int32))


def logarithm(values: F64) -> F64:
    """Natural logarithms of ``values`` [n], positive normal numbers; to some 1e-15."""
    parts, powers = np.frexp(values)
    small = parts < _HALF_ROOT
    parts = np.where(small, 2.0 * parts, parts)
    powers = (powers - small).astype(np.float64)
    way = (parts - 1.0) / (parts + 1.0)
    series = 2.0 * way * _polynomial(_ODD, way * way)
    return np.asarray(powers * _LN2[0] + (powers * _LN2[1] + series))


def _polynomial(coefficients: tuple[float, ...], at: F64) -> F64:
    """Highest power first, by Horner's rule."""
    out = np.full_like(at, coefficients[0])
    for coefficient in coefficients[1:]:
        out = out * at + coefficient
    return out
