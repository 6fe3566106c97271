"""Trajectories as knots: both ends of a span first, then the middle of each interval, predicted by interpolation.

Residuals of middles are zero for linear motion; for smooth motion they shrink by a factor of four per level. Chunks of
smooth motion predict middles from the cubic through the ends of the interval and of those beside it (at the ends of the
span, the parabola) instead of the line; it amplifies noise. Samples are integers in 1/64 of the layer's unit, so every
decoder computes the same bits.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F64

I32 = NDArray[np.int32]

FRACTION_BITS = 6
"""Fractional bits of the fixed-point samples."""

START, END, MIDDLE = 0, 1, 2

WEIGHT_BITS = 12
"""Weights of knots further away are fixed-point numbers of so many fractional bits."""


@dataclass(frozen=True, slots=True)
class Knot:
    """One coded sample of a span: ``at``, between the samples ``left`` and ``right``, which are coded earlier."""

    kind: int
    at: int
    left: int
    right: int
    parent: int
    """The sample whose residuals best predict the size of this one's; -1 for none."""
    before: int = -1
    """The sample left of ``left`` on the predicting curve; -1 for none."""
    after: int = -1
    """The sample right of ``right`` on the predicting curve; -1 for none."""
    weights: tuple[int, int] = (0, 0)
    """Weights of the distances of ``before`` and ``after`` from the line through ``left`` and ``right``."""


@cache
def knots(span: int, *, start: bool, curved: bool = False) -> tuple[Knot, ...]:
    """The knots of ``span`` + 1 samples in coding order. Without ``start``, sample 0 is not coded and is zero.

    With ``curved``, middles are predicted from curves instead of lines.
    """
    first = [Knot(START, 0, 0, 0, -1)] if start else []
    return (*first, Knot(END, span, 0, 0, 0 if start else -1), *_middles(span, curved))


def _middles(span: int, curved: bool) -> Iterator[Knot]:
    intervals = [(0, span, span)]  # left, right, the later of the two
    while intervals:
        below = []
        for number, (left, right, parent) in enumerate(intervals):
            if right - left < 2:
                continue
            at = (left + right) // 2
            knot = Knot(MIDDLE, at, left, right, parent)
            yield _bent(knot, intervals, number) if curved else knot
            below += [(left, at, at), (at, right, at)]
        intervals = below


def _bent(knot: Knot, intervals: Sequence[tuple[int, int, int]], number: int) -> Knot:
    """``knot`` in the middle of the interval ``number``, with those beyond its neighbours."""
    before, after = -1, -1
    if number > 0 and intervals[number - 1][1] == knot.left:
        before = intervals[number - 1][0]
    if number + 1 < len(intervals) and intervals[number + 1][0] == knot.right:
        after = intervals[number + 1][1]
    weights = _weight(knot, before, after), _weight(knot, after, before)
    return replace(knot, before=before, after=after, weights=weights)


def _weight(knot: Knot, of: int, other: int) -> int:
    """Lagrange's weight of the sample ``of`` at ``knot``; ``other`` is the fourth one. -1: there is none."""
    if of < 0:
        return 0
    share = (knot.at - knot.left) * (knot.at - knot.right)
    whole = (of - knot.left) * (of - knot.right)
    if other >= 0:
        share, whole = share * (knot.at - other), whole * (of - other)
    if whole < 0:
        share, whole = -share, -whole
    return ((share << (WEIGHT_BITS + 1)) + whole) // (2 * whole)


def predicted(samples: I32, knot: Knot) -> I32:
    """Prediction of ``knot`` from the ``samples`` [span + 1, ...] coded before it, rounded down on every machine."""
    if knot.kind == START:
        return np.zeros_like(samples[0])
    left: I32 = samples[knot.left]
    if knot.kind == END:
        return left
    guess = left + _rise(samples, knot, knot.at)
    bend = np.zeros_like(guess)
    for at, weight in zip((knot.before, knot.after), knot.weights, strict=True):
        if at >= 0:
            bend += weight * (samples[at].astype(np.int64) - left - _rise(samples, knot, at))
    out: I32 = (guess + (bend >> WEIGHT_BITS)).astype(np.int32)
    return out


def _rise(samples: I32, knot: Knot, at: int) -> NDArray[np.int64]:
    """How far the line through the ends of the interval of ``knot`` has risen ``at`` a sample: rounded down."""
    rise: NDArray[np.int64] = samples[knot.right].astype(np.int64) - samples[knot.left]
    return rise * (at - knot.left) // (knot.right - knot.left)


def quantised(wanted: F64, guess: F64, deadzone: F64 | float) -> I32:
    """Residuals of ``wanted`` against a ``guess``, both in units; 0 within half a unit plus ``deadzone``."""
    off = wanted - guess
    size = np.floor(np.abs(off) + (0.5 - deadzone))
    residual: I32 = (np.sign(off) * size).astype(np.int32)
    return residual
