"""Confidence of a difference between plays: 95 % intervals of paired means."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

BLOCK_FRAMES = 9
"""Frames per observation: neighbouring frames are similar, frames 0.3 s apart hardly are."""

SHARE = 0.95
"""Share of intervals that contain the true mean."""


@dataclass(frozen=True)
class Interval:
    """A mean and its 95 % interval."""

    mean: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.mean:+.2f} [{self.low:+.2f}, {self.high:+.2f}]"

    @property
    def bounded(self) -> bool:
        """Whether there were values enough for an interval."""
        return math.isfinite(self.low) and math.isfinite(self.high)

    def above(self, bound: float) -> bool:
        """Whether the mean is surely above ``bound``."""
        return self.low > bound


def interval(values: Sequence[float]) -> Interval:
    """Interval of the mean of independent ``values``; unbounded for a single value."""
    found = np.asarray(values, np.float64)
    if not len(found) or not np.isfinite(found).all():
        return Interval(math.nan, -math.inf, math.inf)
    mean = float(found.mean())
    if len(found) < 2:
        return Interval(mean, -math.inf, math.inf)
    from scipy.special import stdtrit  # only comparisons need scipy

    t = float(stdtrit(len(found) - 1, (1 + SHARE) / 2))
    spread = t * float(found.std(ddof=1)) / math.sqrt(len(found))
    return Interval(mean, mean - spread, mean + spread)


def paired(ours: Sequence[float], theirs: Sequence[float]) -> Interval:
    """Interval of the mean of ``ours`` minus ``theirs``, paired by frame of one walk, in blocks of
    :data:`BLOCK_FRAMES`.

    Frames of one play are not independent observations; blocks nearly are. The interval is for this walk over this
    link; others differ by more.
    """
    if len(ours) != len(theirs):
        raise ValueError(f"{len(ours)} frames of ours and {len(theirs)} of theirs are no pairs")
    return interval_of_play((np.asarray(ours, np.float64) - np.asarray(theirs, np.float64)).tolist())


def interval_of_play(values: Sequence[float]) -> Interval:
    """Interval of the mean over the frames of one play, in blocks of :data:`BLOCK_FRAMES`."""
    return interval(_blocks(np.asarray(values, np.float64)))


def pooled(differences: Sequence[Sequence[float]]) -> Interval:
    """Interval of the mean over plays of paired differences, each a series of frames; blocks are pooled."""
    return interval([value for series in differences for value in _blocks(np.asarray(series, np.float64))])


def _blocks(series: np.ndarray) -> list[float]:
    count = max(1, len(series) // BLOCK_FRAMES)
    return [float(part.mean()) for part in np.array_split(series, count)] if len(series) else []
