"""Errors of predictors along recorded walks."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cags_common.geometry import angle_between
from cags_common.poses.walks import Walk
from cags_protocol.wire.messages import PoseSample
from cags_server.predict import PoseHistory, Predictor

WARM_UP_US = 2_000_000
"""Start of the evaluation of each walk, so that every predictor has a history."""


@dataclass(frozen=True, slots=True)
class Errors:
    """Errors of one predictor at one horizon, one entry per prediction."""

    angles_deg: np.ndarray
    distances_m: np.ndarray
    expected_deg: np.ndarray  # the predictor's own standard deviation
    seconds: np.ndarray

    def figures(self) -> dict[str, Any]:
        """Mean, 95th percentile, calibration and time."""
        return {
            "predictions": len(self.angles_deg),
            "angular_mean_deg": float(self.angles_deg.mean()),
            "angular_p95_deg": float(np.percentile(self.angles_deg, 95)),
            "position_mean_m": float(self.distances_m.mean()),
            "position_p95_m": float(np.percentile(self.distances_m, 95)),
            "error_over_expected": float(
                np.sqrt(np.mean(self.angles_deg**2)) / max(np.sqrt(np.mean(self.expected_deg**2)), 1e-12)
            ),
            "step_ms_median": float(np.median(self.seconds) * 1e3),
        }


def measure(
    walks: Sequence[Walk], predictors: Mapping[str, Predictor], horizons_us: Sequence[int], every_us: int
) -> Iterator[tuple[str, int, Errors]]:
    """(predictor, horizon, errors) over all ``walks``, predicting every ``every_us`` from recorded samples."""
    rows: dict[tuple[str, int], list[tuple[float, float, float, float]]] = {
        (name, horizon): [] for name in predictors for horizon in horizons_us
    }
    for walk in walks:
        _along(walk, predictors, horizons_us, every_us, rows)
    for (name, horizon), values in rows.items():
        columns = np.array(values, dtype=np.float64).reshape(-1, 4).T
        yield name, horizon, Errors(*columns)


def _along(
    walk: Walk,
    predictors: Mapping[str, Predictor],
    horizons_us: Sequence[int],
    every_us: int,
    rows: dict[tuple[str, int], list[tuple[float, float, float, float]]],
) -> None:
    trace, history, next_us = walk.trace, PoseHistory(), WARM_UP_US
    poses = trace.poses_at(trace.times_us)
    for t, pose in zip(trace.times_us.tolist(), poses, strict=True):
        history.add(PoseSample(t, pose))
        if t < next_us:
            continue
        next_us = t + every_us
        for horizon in horizons_us:
            if t + horizon > trace.duration_us:
                continue
            actual = trace.pose_at(t + horizon)
            for name, predictor in predictors.items():
                started = time.perf_counter()
                guess = predictor.predict(history, horizon)
                seconds = time.perf_counter() - started
                angle = math.degrees(angle_between(guess.pose.rotation, actual.rotation))
                distance = math.dist(guess.pose.position, actual.position)
                expected = math.degrees(math.hypot(*guess.rotation_std_rad))
                rows[name, horizon].append((angle, distance, expected, seconds))
