"""Statistics of a clip's tracks: how many splats continue, for how long, and which attributes change."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle.tracks import ChangedShares, TrackStatistics
from cags_common.geometry import F64
from cags_common.splats import Splats
from cags_encoder.tracks.effect import attribute_effects

VISIBLE = 0.01
"""Smallest change that counts, as a share of a pixel's colour (documented in :class:`ChangedShares`)."""

SAMPLE = 4096
"""Number of splats of a frame that are examined for changes."""


class TrackCounter:
    """Counts frames as they come, in order. It keeps one frame's rows in memory."""

    def __init__(self) -> None:
        self._frames = self._tracks = self._seen = self._linked = self._judged = 0
        self._ages: NDArray[np.int64] = np.zeros(0, np.int64)  # age of the last frame's splats: number of frames seen
        self._ended: NDArray[np.int64] = np.zeros(0, np.int64)  # number of ended tracks by the logarithm of their age
        self._changed = {field.name: 0 for field in fields(ChangedShares)}

    def add(self, before: Splats | None, after: Splats, rows: NDArray[np.intp]) -> None:
        """Add the next frame: row i of ``after`` [n] continues row ``rows[i]`` of ``before``, or none (-1)."""
        found = rows >= 0
        lost = np.ones(len(self._ages), bool)
        lost[rows[found]] = False
        self._ended = _added(self._ended, _bins(self._ages[lost]))
        ages = np.ones(len(rows), np.int64)
        ages[found] += self._ages[rows[found]]
        self._ages = ages
        self._frames += 1
        self._tracks += int((~found).sum())
        if self._frames > 1:
            self._seen += len(rows)
            self._linked += int(found.sum())
        if before is not None and found.any():
            self._judge(before, after, rows, np.flatnonzero(found))

    def statistics(self) -> TrackStatistics:
        """Statistics of the frames so far."""
        ended = _added(self._ended, _bins(self._ages))
        return TrackStatistics(
            frames=self._frames,
            tracks=self._tracks,
            linked_share=self._linked / self._seen if self._seen else 0.0,
            life_mean_frames=(self._linked + self._tracks) / max(self._tracks, 1),
            life_histogram=tuple(ended.tolist()),
            changed=ChangedShares(**{name: count / max(self._judged, 1) for name, count in self._changed.items()}),
        )

    def _judge(self, before: Splats, after: Splats, rows: NDArray[np.intp], found: NDArray[np.intp]) -> None:
        sample = found[:: max(1, len(found) // SAMPLE)]
        for name, effect in attribute_effects(before.take(rows[sample]), after.take(sample)).items():
            self._changed[name] += int((effect > VISIBLE).sum())
        self._judged += len(sample)


def _bins(ages: NDArray[np.int64]) -> NDArray[np.int64]:
    """Histogram by the integer part of the binary logarithm."""
    powers: F64 = np.frexp(ages.astype(np.float64))[1] - 1.0
    return np.bincount(powers.astype(np.int64)).astype(np.int64)


def _added(a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.int64]:
    out = np.zeros(max(len(a), len(b)), np.int64)
    out[: len(a)] += a
    out[: len(b)] += b
    return out
