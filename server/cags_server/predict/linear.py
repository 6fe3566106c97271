"""Constant linear and angular velocity."""

from __future__ import annotations

import numpy as np

from cags_server.predict.base import PoseDistribution
from cags_server.predict.history import PoseHistory
from cags_server.predict.tangent import Weights, backtest, displacement, distribution, increments, steps_of

VELOCITY_STEPS = 2
"""Increments that the velocity is averaged over (67 ms): fewer follow the tracker's noise, more lag behind."""


class LinearPredictor:
    """Carries the newest linear and angular velocity (camera axes, on SO(3)) through the horizon."""

    def predict(self, history: PoseHistory, horizon_us: int) -> PoseDistribution:
        """See :class:`~cags_server.predict.base.Predictor`."""
        moves = increments(history)
        steps = steps_of(horizon_us)
        used = max(1, min(VELOCITY_STEPS, len(moves)))
        weight = np.full(used, steps / used)
        weights = Weights(weight, weight)
        return distribution(history, displacement(moves, weights), backtest(moves, weights, steps))
