"""Coverage of field-of-view policies over the requested area, along recorded walks.

A reference with ``gain`` times a policy's margins covers a share of the client's view and is correspondingly larger.
Sweeping the gain gives a curve for each policy; policies are compared at equal area.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cags_bench.predict.precision import WARM_UP_US
from cags_common.geometry import F64, Intrinsics, Pose
from cags_common.poses.room import Room
from cags_common.poses.walks import Walk
from cags_protocol.wire.messages import PoseSample
from cags_server.fov import FovObservation, FovPolicy
from cags_server.fov.base import MAX_REFERENCE_FOV_RAD, client_halves
from cags_server.fov.truth import NEAREST, exact_margins, fast_margins, in_reference, margins_for, view_rays
from cags_server.predict import PoseHistory, Predictor

CLIENT = Intrinsics.of_fov(1600, 1200, 1.48, 1.20)
"""Client view of the paper."""

PERIOD_US = 33_333
GAINS = tuple(np.concatenate([[0.0], np.geomspace(0.2, 8.0, 40)]).tolist())
RAYS = view_rays(CLIENT, 25, 19)


@dataclass
class Curve:
    """One policy: coverage and area by gain, summed over frames."""

    frames: int = 0
    covered: list[F64] = field(default_factory=list)  # [G] shares of each frame
    area: F64 = field(default_factory=lambda: np.zeros(len(GAINS)))
    seconds: list[float] = field(default_factory=list)

    def add(self, points: F64, margins: tuple[float, float]) -> None:
        """Add a frame whose visible ``points`` [R, 3] are given in the reference camera's axes."""
        limits = np.array([_half_widths(margins, gain) for gain in GAINS])  # [G, 2] on the plane z = 1
        front = points[:, 2] > NEAREST
        flat = np.abs(points[:, :2] / np.where(front, points[:, 2], 1.0)[:, None])
        inside = front & (flat[None, :, 0] <= limits[:, :1] + 1e-6) & (flat[None, :, 1] <= limits[:, 1:] + 1e-6)
        plain = np.tan(client_halves(CLIENT))
        self.frames += 1
        self.covered.append(inside.mean(axis=1))
        self.area += limits.prod(axis=1) / plain.prod()

    def figures(self, areas: Sequence[float]) -> dict[str, Any]:
        """Coverage (%) with the own margins and at equal areas (mean, worst 5 %), and the smallest area that covers 98
        %.
        """
        shares = 100 * np.array(self.covered)
        covered, low, area = shares.mean(axis=0), np.percentile(shares, 5, axis=0), self.area / self.frames
        return {
            "frames": self.frames,
            "coverage_pct": float(np.interp(1.0, GAINS, covered)),
            "area": float(np.interp(1.0, GAINS, area)),
            "coverage_at_area_pct": {f"{a:g}": float(np.interp(a, area, covered)) for a in areas},
            "coverage_p05_at_area_pct": {f"{a:g}": float(np.interp(a, area, low)) for a in areas},
            "area_for_98_pct": float(np.interp(98.0, covered, area)) if covered[-1] >= 98.0 else None,
            "step_ms_median": float(np.median(self.seconds) * 1e3),
        }


def _half_widths(margins: tuple[float, float], gain: float) -> tuple[float, float]:
    halves = client_halves(CLIENT)
    wide = [min(half * (1 + gain * s), MAX_REFERENCE_FOV_RAD / 2) for half, s in zip(halves, margins, strict=True)]
    return float(np.tan(wide[0])), float(np.tan(wide[1]))


@dataclass
class _Flight:
    frame: int
    display_us: int
    predicted: Pose


def measure(
    walks: Sequence[Walk], predictor: Predictor, make: Mapping[str, Any], lead_us: int, seconds: float
) -> dict[str, Curve]:
    """Curves of the policies in ``make`` (name -> factory), for a server that plans ``lead_us`` ahead."""
    curves = {name: Curve() for name in make}
    for walk in walks:
        policies: dict[str, FovPolicy] = {name: factory() for name, factory in make.items()}
        _along(walk, predictor, policies, curves, lead_us=lead_us, seconds=seconds)
    return curves


def _along(
    walk: Walk,
    predictor: Predictor,
    policies: Mapping[str, FovPolicy],
    curves: Mapping[str, Curve],
    *,
    lead_us: int,
    seconds: float,
) -> None:
    trace = walk.trace
    room, history, flying = Room.around(trace.positions), PoseHistory(), deque[_Flight]()
    samples = deque(zip(trace.times_us.tolist(), trace.poses_at(trace.times_us), strict=True))
    end_us = min(trace.duration_us - lead_us, WARM_UP_US + round(seconds * 1e6))
    for frame, now_us in enumerate(range(WARM_UP_US, end_us, PERIOD_US)):
        while samples and samples[0][0] <= now_us:
            history.add(PoseSample(*samples.popleft()))
        while flying and flying[0].display_us <= history.newest.t_us:
            known = flying.popleft()
            for policy in policies.values():
                policy.truth(known.frame, known.predicted, trace.pose_at(known.display_us), CLIENT)
        display_us = now_us + lead_us
        guess = predictor.predict(history, display_us - history.newest.t_us)
        actual = trace.pose_at(display_us)
        seen = room.points(np.array(actual.position), actual.rotation_matrix, RAYS)
        points = in_reference(seen, actual, guess.pose)
        observation = FovObservation(frame, guess, CLIENT)
        for name, policy in policies.items():
            started = time.perf_counter()
            margins = policy.scale(observation)
            curves[name].seconds.append(time.perf_counter() - started)
            curves[name].add(points, margins)
        flying.append(_Flight(frame, display_us, guess.pose))


def fast_against_exact(walks: Sequence[Walk], predictor: Predictor, lead_us: int, every_us: int) -> dict[str, Any]:
    """Mean difference between fast and exact margins by depth of the corners, and the time of both."""
    differences: dict[str, list[float]] = {"2": [], "10": []}
    times: dict[str, list[float]] = {"exact": [], "fast": []}
    for walk in walks:
        trace, room = walk.trace, Room.around(walk.trace.positions)
        for t in range(WARM_UP_US, trace.duration_us - lead_us, every_us):
            recent = trace.times_us[(trace.times_us <= t) & (trace.times_us > t - 2_000_000)]
            history = PoseHistory(PoseSample(int(s), trace.pose_at(int(s))) for s in recent)
            actual = trace.pose_at(t + lead_us)
            predicted = predictor.predict(history, t + lead_us - history.newest.t_us).pose
            seen = room.points(np.array(actual.position), actual.rotation_matrix, RAYS)
            exact = margins_for(in_reference(seen, actual, predicted), CLIENT)
            for depth, values in differences.items():
                started = time.perf_counter()
                fast = fast_margins(CLIENT, actual, predicted, float(depth))
                times["fast"].append(time.perf_counter() - started)
                values.append(float(np.mean(np.abs(np.subtract(fast, exact)))))
            depth_map = room.points(np.array(actual.position), actual.rotation_matrix, view_rays(CLIENT, 400, 300))
            started = time.perf_counter()
            exact_margins(depth_map[:, 2].reshape(300, 400), CLIENT, actual, predicted)
            times["exact"].append(time.perf_counter() - started)
    return {
        "mean_difference_by_depth_m": {depth: float(np.mean(values)) for depth, values in differences.items()},
        "exact_ms_median": float(np.median(times["exact"]) * 1e3),
        "fast_ms_median": float(np.median(times["fast"]) * 1e3),
    }
