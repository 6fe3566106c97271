"""Tables of codebooks on steps: what is written of an entry is how far it is from its parent, in a few bits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32, F64
from cags_common.tiles.svq import MAX_EXPONENT, MAX_STEPS

STEP_SHARE = 1 / 3
"""Largest step of an entry, in standard deviations of what the entry leaves over: it adds 0.2 to 1 % to that error."""

FINE_ROWS = 64
"""The step's share is at most the root of a table's rows, divided by this: bits of small tables cost nothing."""

SIGNIFICANT_BITS = 20
"""Entries are sums of steps that float32 holds exactly."""

SPREAD_BITS = 3
"""Bits of the fraction of a spread."""

_LIMIT = 6e4
_TINY = 2.0**-14
"""Smallest spread: the smallest normal float16."""


def on_steps(tables: Sequence[F64], left: Sequence[F64]) -> list[F32]:
    """A stage's tables, each [2**bits, dim] for as many bits as the one before or more, rounded for a codebook.

    ``left`` holds for each table the standard deviations [dim] of what its entries leave of the values.
    """
    rounded: list[F32] = []
    for table, deviations in zip(tables, left, strict=True):
        values = np.clip(table, -_LIMIT, _LIMIT)
        parents = np.repeat(rounded[-1], len(table) // len(rounded[-1]), axis=0) if rounded else np.zeros_like(values)
        rounded.append(_rounded(values, parents.astype(np.float64), deviations))
    return rounded


def rounded_spreads(spreads: F64) -> F32:
    """Positive spreads with the bits that a codebook keeps of them."""
    fraction, exponent = np.frexp(np.clip(spreads, _TINY, _LIMIT / 2))
    words = np.rint(np.ldexp(fraction, SPREAD_BITS + 1))
    return np.asarray(np.ldexp(words, exponent - SPREAD_BITS - 1), np.float32)


def _rounded(values: F64, parents: F64, deviations: F64) -> F32:
    away = values - parents
    finest = np.maximum(
        _exponents(np.abs(away).max(axis=0)) - 15, _exponents(np.abs(values).max(axis=0)) - SIGNIFICANT_BITS
    )
    share = min(STEP_SHARE, np.sqrt(len(values)) / FINE_ROWS)
    exponents = np.clip(np.maximum(_exponents(deviations * share) - 1, finest), -MAX_EXPONENT, MAX_EXPONENT)
    counts = np.clip(np.rint(np.ldexp(away, -exponents)), -MAX_STEPS, MAX_STEPS)
    return np.asarray(parents + np.ldexp(counts, exponents), np.float32)


def _exponents(values: F64) -> NDArray[np.int64]:
    """The smallest e with values < 2**e; the least of all for zero."""
    return np.where(values > 0, np.frexp(values)[1], -MAX_EXPONENT).astype(np.int64)
