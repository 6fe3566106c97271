"""Stages of looking ahead: pose prediction, and the margins of the reference's field of view."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cags_bench.cost.engine import Outcome, Point, Stage
from cags_bench.cost.moments import Workbench
from cags_bench.cost.serving import FPS
from cags_bench.sim.seeds import walk_of
from cags_common.geometry import Intrinsics, Pose, angle_between
from cags_common.poses import Focus
from cags_protocol.wire.messages import PoseSample
from cags_server.fov import FOV_POLICIES, FovObservation, FovPolicy, create_fov_policy
from cags_server.fov.base import widened
from cags_server.fov.truth import in_reference, view_rays
from cags_server.predict import PREDICTORS, create_predictor
from cags_server.predict.base import PoseDistribution
from cags_server.predict.history import PoseHistory
from cags_server.session.viewer import fov_options
from cags_server.settings import ServerSettings

SHIPPED = ServerSettings()
"""Defaults of the server."""

FRAME_US = round(1e6 / FPS)
HORIZON_US = SHIPPED.lead_frames * FRAME_US
POSE_PERIOD_US = 16_667
HISTORY_US = 2_000_000
STEPS = 60
"""Frames of a walk that are predicted at each moment."""

POINT_DEPTH = 3.0
"""Depth in world units for measuring coverage."""

FIXED = "fixed"
"""Name of the policy with one margin."""


@dataclass(frozen=True)
class Walked:
    """Part of a walk: what a server knows when it plans each frame, and the pose that follows."""

    histories: Sequence[PoseHistory]
    actual: Sequence[Pose]
    """The viewer's pose when each frame is displayed."""

    @classmethod
    def along(cls, pose_at: Callable[[int], Pose]) -> Walked:
        """:data:`STEPS` frames after two seconds of a walk."""
        histories = [_history_until(pose_at, HISTORY_US + step * FRAME_US) for step in range(STEPS)]
        return cls(histories, [pose_at(history.newest.t_us + HORIZON_US) for history in histories])


def looking_stages(bench: Workbench) -> list[Stage]:
    """Predictors, and margins of the field of view with the default predictor; on another walk at each moment."""
    focus = Focus((0.0, 0.0, 0.0), 1.0, (0.0, 1.0, 0.0))
    window_us = HISTORY_US + STEPS * FRAME_US + HORIZON_US
    walked = Walked.along(walk_of(bench.poses, focus, window_us, bench.walk_seed).pose_at)
    return [_predictors(walked), _margins(walked, bench.moment.camera.intrinsics)]


def _history_until(pose_at: Callable[[int], Pose], end_us: int) -> PoseHistory:
    times = range(end_us - HISTORY_US, end_us, POSE_PERIOD_US)
    return PoseHistory(PoseSample(t, pose_at(t)) for t in times)


def _predictors(walked: Walked) -> Stage:
    def judge(found: list[PoseDistribution]) -> Outcome:
        pairs = [(f.pose, actual) for f, actual in zip(found, walked.actual, strict=True)]
        angles = [angle_between(ours.rotation, actual.rotation) for ours, actual in pairs]
        return {
            "error_deg": math.degrees(float(np.mean(angles))),
            "error_p95_deg": math.degrees(float(np.percentile(angles, 95))),
            "error_position": float(np.mean([math.dist(ours.position, actual.position) for ours, actual in pairs])),
        }

    def point(name: str) -> Point:
        predictor = create_predictor(name)

        def run() -> list[PoseDistribution]:
            return [predictor.predict(history, HORIZON_US) for history in walked.histories]

        return Point(name, run, judge, default=name == SHIPPED.predictor)

    points = tuple(map(point, PREDICTORS.names()))
    return Stage("prediction", f"predictor, {STEPS} calls", "server", "error_deg", points, sized=False)


def _margins(walked: Walked, client: Intrinsics) -> Stage:
    """Share of the client's view that the reference covers at one depth, and the area that its pixels cover."""
    predictor = create_predictor(SHIPPED.predictor)
    predicted = [predictor.predict(history, HORIZON_US) for history in walked.histories]
    rays = view_rays(client, 25, 19) * POINT_DEPTH

    def judge(margins: list[tuple[float, float]]) -> Outcome:
        covered, areas = [], []
        for found, actual, margin in zip(predicted, walked.actual, margins, strict=True):
            reference = widened(client, margin, SHIPPED.reference_width, SHIPPED.reference_height)
            covered.append(_covered(in_reference(rays, actual, found.pose), reference))
            areas.append(_area(reference) / _area(client))
        return {"coverage": float(np.mean(covered)), "area_ratio": float(np.mean(areas))}

    def point(label: str, settings: ServerSettings) -> Point:
        def run() -> list[tuple[float, float]]:
            policy = create_fov_policy(settings.fov, fov_options(settings))
            return _scales(policy, predicted, walked.actual, client)

        return Point(label, run, judge, default=settings == SHIPPED)

    fixed = [replace(SHIPPED, fov=FIXED, fov_margin=m) for m in sorted({0.0, 0.1, 0.2, 0.4, SHIPPED.fov_margin})]
    points = [point(f"{FIXED} +{settings.fov_margin:.0%}", settings) for settings in fixed]
    points += [point(name, replace(SHIPPED, fov=name)) for name in FOV_POLICIES.names() if name != FIXED]
    knob = f"policy, {STEPS} frames"
    return Stage("field of view", knob, "server", "coverage", tuple(points), costs=("area_ratio",), sized=False)


def _scales(
    policy: FovPolicy, predicted: Sequence[PoseDistribution], actual: Sequence[Pose], client: Intrinsics
) -> list[tuple[float, float]]:
    """Margins of every frame; a frame's true pose becomes known when it is displayed."""
    out, flying = [], deque[int]()
    for frame, found in enumerate(predicted):
        if len(flying) == SHIPPED.lead_frames:
            shown = flying.popleft()
            policy.truth(shown, predicted[shown].pose, actual[shown], client)
        out.append(policy.scale(FovObservation(frame, found, client)))
        flying.append(frame)
    return out


def _area(view: Intrinsics) -> float:
    """Area of a view on the plane at distance 1."""
    return math.prod(math.tan(fov / 2) for fov in view.fov_rad)


def _covered(points: np.ndarray, reference: Intrinsics) -> float:
    """Share of ``points`` [N, 3], in the reference camera's axes, that its picture holds."""
    z = np.maximum(points[:, 2], 1e-9)
    x = points[:, 0] / z * reference.fx_px + reference.cx_px
    y = points[:, 1] / z * reference.fy_px + reference.cy_px
    inside = (points[:, 2] > 0) & (x >= 0) & (x <= reference.width_px) & (y >= 0) & (y <= reference.height_px)
    return float(inside.mean())
