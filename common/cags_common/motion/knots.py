"""Trajectories as knots: both ends of a span first, then the middle of each interval, predicted by interpolation.

Residuals of middles are zero for linear motion; for smooth motion they shrink by a factor of four per level. Samples
are integers in 1/64 of the layer's unit, so every decoder computes the same bits.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F64

I32 = NDArray[np.int32]

FRACTION_BITS = 6
"""Fractional bits of the fixed-point samples."""

START, END, MIDDLE = 0, 1, 2


@dataclass(frozen=True, slots=True)
class Knot:
    """One coded sample of a span: ``at``, between the samples ``left`` and ``right``, which are coded earlier."""

    kind: int
    at: int
    left: int
    right: int
    parent: int
    """The sample whose residuals best predict the size of this one's; -1 for none."""


@cache
def knots(span: int, *, start: bool) -> tuple[Knot, ...]:
    """The knots of ``span`` + 1 samples in coding order. Without ``start``, sample 0 is not coded and is zero."""
    first = [Knot(START, 0, 0, 0, -1)] if start else []
    return (*first, Knot(END, span, 0, 0, 0 if start else -1), *_middles(span))


def _middles(span: int) -> Iterator[Knot]:
    intervals = [(0, span, span)]  # left, right, the later of the two
    while intervals:
        below = []
        for left, right, parent in intervals:
            if right - left < 2:
                continue
            at = (left + right) // 2
            yield Knot(MIDDLE, at, left, right, parent)
            below += [(left, at, at), (at, right, at)]
        intervals = below


def predicted(samples: I32, knot: Knot) -> I32:
    """Prediction of ``knot`` from the ``samples`` [span + 1, ...] coded before it, rounded down on every machine."""
    if knot.kind == START:
        return np.zeros_like(samples[0])
    left: I32 = samples[knot.left]
    if knot.kind == END:
        return left
    rise = (samples[knot.right].astype(np.int64) - left) * (knot.at - knot.left) // (knot.right - knot.left)
    guess: I32 = (left + rise).astype(np.int32)
    return guess


def quantised(wanted: F64, guess: I32, deadzone: F64 | float) -> I32:
    """Residuals of ``wanted`` (units) against a ``guess`` (fixed point); 0 within half a unit plus ``deadzone``."""
    off = wanted - guess / (1 << FRACTION_BITS)
    size = np.floor(np.abs(off) + (0.5 - deadzone))
    residual: I32 = (np.sign(off) * size).astype(np.int32)
    return residual
