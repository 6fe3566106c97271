"""The prediction seam: poses seen so far in, a pose in the future and its uncertainty out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from cags_common.geometry import Pose, Vec3
from cags_server.predict.history import PoseHistory

MAX_HORIZON_US = 1_000_000
"""Nobody's head is predictable further ahead; a longer horizon is predicted as this one."""


@dataclass(frozen=True, slots=True)
class PoseDistribution:
    """A predicted pose ``T_world_camera`` and one standard deviation of its error, axis by axis."""

    pose: Pose
    rotation_std_rad: Vec3  # about the predicted camera's own axes: pitch (X), yaw (Y), roll (Z)
    position_std_m: Vec3  # along the world's axes, world units


class Predictor(Protocol):
    """Guesses where a viewer's camera will be. A pure function of the history."""

    def predict(self, history: PoseHistory, horizon_us: int) -> PoseDistribution:
        """The pose ``horizon_us`` after the newest sample of ``history``, which must hold at least one.

        A horizon below zero counts as zero, one above ``MAX_HORIZON_US`` as that. The result is always finite.
        Raises ``ValueError`` for an empty history.
        """
        ...
