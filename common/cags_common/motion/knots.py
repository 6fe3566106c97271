"""Trajectories as knots: the ends of a span first, then the middle of every interval against the line through its ends.

Linear motion has no middles; smooth motion has small ones, a quarter a level. Samples are integers in 1/64 of the
layer's unit, so that a line is followed to 1/64 and every decoder gives the same bits.
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
"""Samples are fixed-point numbers of so many fractional bits."""

START, END, MIDDLE = 0, 1, 2


@dataclass(frozen=True, slots=True)
class Knot:
    """One sample of a span that is coded: ``at`` between the samples ``left`` and ``right``, which come before it."""

    kind: int
    at: int
    left: int
    right: int
    parent: int
    """The sample whose residuals tell most of this one's size; -1 for none."""


@cache
def knots(span: int, *, start: bool) -> tuple[Knot, ...]:
    """The knots of ``span`` + 1 samples in coding order; sample 0 is coded only with ``start``, else it is zero."""
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
    """What ``samples`` [span + 1, ...] before ``knot`` lead to expect of it: rounded down, the same everywhere."""
    if knot.kind == START:
        return np.zeros_like(samples[0])
    left: I32 = samples[knot.left]
    if knot.kind == END:
        return left
    rise = (samples[knot.right].astype(np.int64) - left) * (knot.at - knot.left) // (knot.right - knot.left)
    guess: I32 = (left + rise).astype(np.int32)
    return guess


def quantised(wanted: F64, guess: I32, deadzone: float) -> I32:
    """Residuals of ``wanted`` (units) against a ``guess`` (fixed point); within half a unit and ``deadzone``: none."""
    off = wanted - guess / (1 << FRACTION_BITS)
    size = np.floor(np.abs(off) + (0.5 - deadzone))
    residual: I32 = (np.sign(off) * size).astype(np.int32)
    return residual
