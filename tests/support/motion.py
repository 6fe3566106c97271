"""Made-up head motion with a known future."""

from __future__ import annotations

import math

from cags_common.geometry import Pose, quaternion_of_rotation_vector
from cags_protocol.wire.messages import PoseSample
from cags_server.predict import PoseHistory

PERIOD_US = 27_700  # the 36 Hz of a headset


def turning_pose(t_us: int, rad_s: float = 1.0, m_s: float = 0.5) -> Pose:
    """Constant turn about the camera's Y axis and constant motion along X."""
    t = t_us / 1e6
    return Pose((m_s * t, 1.6, 0.0), quaternion_of_rotation_vector((0.0, rad_s * t, 0.0)))


def swaying_pose(t_us: int) -> Pose:
    """Looking about as a person does: two sines of yaw and one of pitch."""
    t = t_us / 1e6
    yaw = 0.6 * math.sin(1.7 * t) + 0.2 * math.sin(4.1 * t + 1)
    turned = quaternion_of_rotation_vector((0.1 * math.sin(2.3 * t), yaw, 0.0))
    return Pose((0.2 * math.sin(1.1 * t), 1.6 + 0.02 * math.sin(9 * t), 0.1 * t), turned)


def history_of(pose_at, end_us: int = 3_000_000, period_us: int = PERIOD_US, start_us: int = 0) -> PoseHistory:
    return PoseHistory(PoseSample(t, pose_at(t)) for t in range(start_us, end_us + 1, period_us))
