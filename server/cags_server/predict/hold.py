"""The viewer stays where the newest sample saw them."""

from __future__ import annotations

from cags_server.predict.base import PoseDistribution
from cags_server.predict.history import PoseHistory
from cags_server.predict.tangent import Weights, backtest, displacement, distribution, increments, steps_of


class HoldPredictor:
    """Predicts the newest pose, with the uncertainty of how far the viewer usually goes in that time."""

    def predict(self, history: PoseHistory, horizon_us: int) -> PoseDistribution:
        """See :class:`~cags_server.predict.base.Predictor`."""
        moves = increments(history)
        still = Weights.zero()
        return distribution(history, displacement(moves, still), backtest(moves, still, steps_of(horizon_us)))
