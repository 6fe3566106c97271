"""Margins of the field of view from the predictor's own error estimate: small while the viewer is still."""

from __future__ import annotations

import math
from statistics import NormalDist

from cags_common.geometry import Intrinsics, Pose
from cags_server.fov.base import FovObservation, client_halves

SCENE_DEPTH_M = 2.0
"""Depth at which an error of position is turned into an angle: near things move most in the picture."""


class QuantileFov:
    """Margins that hold the viewer's error on each side with probability ``quantile``, if errors are normal."""

    def __init__(self, quantile: float, depth_m: float = SCENE_DEPTH_M) -> None:
        if not 0 < quantile < 1:
            raise ValueError(f"quantile = {quantile} must lie strictly between 0 and 1")
        self._deviations = NormalDist().inv_cdf((1 + quantile) / 2)
        self._depth_m = depth_m

    def scale(self, observation: FovObservation) -> tuple[float, float]:
        """See :class:`~cags_server.fov.base.FovPolicy`."""
        half_x, half_y = client_halves(observation.client)
        pitch, yaw, roll = observation.predicted.rotation_std_rad
        shift = math.hypot(*observation.predicted.position_std_m) / math.sqrt(3) / self._depth_m
        # Yaw moves the left and right borders, pitch the others; roll lifts a corner by the other half of the view.
        side = math.hypot(yaw, shift, roll * math.tan(half_y))
        top = math.hypot(pitch, shift, roll * math.tan(half_x))
        return self._deviations * side / half_x, self._deviations * top / half_y

    def truth(self, frame: int, predicted: Pose, actual: Pose, client: Intrinsics) -> None:
        """The predictor keeps its own record of errors."""
