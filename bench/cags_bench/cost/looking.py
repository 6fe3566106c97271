"""Stages of looking ahead: pose prediction, and the margins of the reference's field of view."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from cags_bench.cost.engine import Outcome, Point, Stage
from cags_common.geometry import Intrinsics, Pose, angle_between
from cags_common.poses import Focus, open_poses
from cags_protocol.wire.messages import PoseSample
from cags_server.fov.base import widened
from cags_server.predict import PREDICTORS, create_predictor
from cags_server.predict.base import PoseDistribution
from cags_server.predict.history import PoseHistory

HORIZON_US = 200_000
POSE_PERIOD_US = 16_667
STEPS = 40
POINT_DEPTH = 3.0
"""Depth in world units for measuring coverage."""


def looking_stages(poses: str, client: Intrinsics) -> list[Stage]:
    """Predictors, and fixed margins of the field of view with the default predictor."""
    walk = open_poses(poses, Focus((0.0, 0.0, 0.0), 1.0, (0.0, 1.0, 0.0)), window_us=10_000_000)
    starts = [1_000_000 + i * 200_000 for i in range(STEPS)]
    histories = [_history_until(walk.pose_at, start) for start in starts]
    truths = [walk.pose_at(history.newest.t_us + HORIZON_US) for history in histories]
    predicted = [create_predictor("autoregressive").predict(h, HORIZON_US).pose for h in histories]
    return [_predictors(histories, truths), _margins(predicted, truths, client)]


def _history_until(pose_at: Callable[[int], Pose], end_us: int) -> PoseHistory:
    times = range(max(0, end_us - 2_000_000), end_us, POSE_PERIOD_US)
    return PoseHistory(PoseSample(t, pose_at(t)) for t in times)


def _predictors(histories: list[PoseHistory], truths: list[Pose]) -> Stage:
    def judge(found: list[PoseDistribution]) -> Outcome:
        angles = [angle_between(f.pose.rotation, t.rotation) for f, t in zip(found, truths, strict=True)]
        metres = [math.dist(f.pose.position, t.position) for f, t in zip(found, truths, strict=True)]
        return {
            "error_deg": math.degrees(float(np.mean(angles))),
            "error_p95_deg": math.degrees(float(np.percentile(angles, 95))),
            "error_position": float(np.mean(metres)),
            "calls": len(found),
        }

    def point(name: str) -> Point:
        predictor = create_predictor(name)
        return Point(
            name, lambda: [predictor.predict(h, HORIZON_US) for h in histories], judge, default=name == "autoregressive"
        )

    return Stage("prediction", f"predictor, {STEPS} calls", "server", "error_deg", tuple(map(point, PREDICTORS)))


def _margins(predicted: list[Pose], truths: list[Pose], client: Intrinsics) -> Stage:
    """Share of the client's view covered by the reference at one depth, and the area covered by its pixels."""
    rays = _rays(client)

    def point(margin: float) -> Point:
        reference = widened(client, (margin, margin), 400, 300)

        def run() -> float:
            return float(np.mean([_covered(rays, t, p, reference) for p, t in zip(predicted, truths, strict=True)]))

        area = math.prod(math.tan(f / 2) for f in reference.fov_rad) / math.prod(
            math.tan(f / 2) for f in client.fov_rad
        )
        return Point(
            f"+{margin:.0%}", run, lambda share: {"coverage": share, "area_ratio": area}, default=margin == 0.1
        )

    return Stage("field of view", "fixed margin", "server", "coverage", tuple(map(point, (0.0, 0.1, 0.2, 0.4))))


def _rays(client: Intrinsics) -> np.ndarray:
    """[P, 3] points of the client's view at :data:`POINT_DEPTH`, camera frame."""
    x, y = np.meshgrid(np.linspace(0, client.width_px, 24), np.linspace(0, client.height_px, 18))
    directions = np.stack(
        [(x - client.cx_px) / client.fx_px, (y - client.cy_px) / client.fy_px, np.ones_like(x)], axis=-1
    )
    return directions.reshape(-1, 3) * POINT_DEPTH


def _covered(points: np.ndarray, seen_from: Pose, rendered_from: Pose, reference: Intrinsics) -> float:
    world = points @ seen_from.rotation_matrix.T + np.asarray(seen_from.position)
    local = (world - np.asarray(rendered_from.position)) @ rendered_from.rotation_matrix
    z = np.maximum(local[:, 2], 1e-9)
    x = local[:, 0] / z * reference.fx_px + reference.cx_px
    y = local[:, 1] / z * reference.fy_px + reference.cy_px
    inside = (local[:, 2] > 0) & (x >= 0) & (x <= reference.width_px) & (y >= 0) & (y <= reference.height_px)
    return float(inside.mean())
