"""Baseline predictor: one pooled autoregression for all axes, applied step by step."""

from __future__ import annotations

import numpy as np

from cags_server.predict.base import PoseDistribution
from cags_server.predict.history import PoseHistory
from cags_server.predict.tangent import Weights, backtest, displacement, distribution, increments, steps_of

# Ridge regression (1e-3 of the mean energy) on 33 ms increments of EyeNavGS people 01-08, newest increment first: one
# vector for the three axes of rotation, one for those of position.
ROTATION = (1.1063, -0.1234, -0.0499, -0.0122, 0.0251, 0.0010, 0.0090, -0.0013, -0.0038, -0.0040)
POSITION = (0.7880, 0.2918, 0.0574, -0.0609, 0.0182, -0.0855, -0.0033, 0.0153, -0.0375, -0.0194)


class PooledAr10:
    """AR(10), applied recursively over the horizon."""

    def predict(self, history: PoseHistory, horizon_us: int) -> PoseDistribution:
        """See :class:`~cags_server.predict.base.Predictor`."""
        moves, steps = increments(history), steps_of(horizon_us)
        weights = Weights(_over_horizon(ROTATION, steps), _over_horizon(POSITION, steps))
        return distribution(history, displacement(moves, weights), backtest(moves, weights, steps))


def _over_horizon(coefficients: tuple[float, ...], steps: float) -> np.ndarray:
    """[10] weights of the displacement over ``steps`` grid steps; the last step may be fractional."""
    order = len(coefficients)
    state, total, remaining = np.eye(order), np.zeros(order), steps
    while remaining > 0:
        following = np.asarray(coefficients) @ state
        total += following * min(1.0, remaining)
        state = np.concatenate([following[None], state[:-1]])
        remaining -= 1.0
    return total
