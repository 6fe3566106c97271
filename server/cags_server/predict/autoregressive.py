"""Autoregression on motion increments, refitted online (the paper's predictor, section 4.3 and its evaluation).

The next increment is a weighted sum of the last ``ORDER`` ones; the same weights serve all three axes of a part, so
that four seconds of history determine them well. The fit is a ridge regression drawn towards a prior: with little
history, or one without information (rank deficient), the prior is what remains.
"""

from __future__ import annotations

import numpy as np

from cags_common.geometry import F64
from cags_server.predict.base import PoseDistribution
from cags_server.predict.history import PoseHistory
from cags_server.predict.tangent import (
    POSITION,
    ROTATION,
    Weights,
    backtest,
    displacement,
    distribution,
    increments,
    steps_of,
)

ORDER = 10
"""Increments that the next one is regressed on (a third of a second)."""

PRIOR_PERSISTENCE = 0.9
"""Share of the newest increment that the prior carries on, so that motion dies out instead of running away."""

RIDGE = 30.0
"""Weight of the prior, in rows of data of average energy."""

MAX_GROWTH = 1.5
"""A predicted increment is at most so many times the largest one in the history: fits can be unstable."""


class AutoregressivePredictor:
    """AR(10) in the tangent space by ridge regression towards a damped constant velocity."""

    def predict(self, history: PoseHistory, horizon_us: int) -> PoseDistribution:
        """See :class:`~cags_server.predict.base.Predictor`."""
        moves = increments(history)
        steps = steps_of(horizon_us)
        weights = Weights(
            _bounded(horizon_weights(fit(moves[:, ROTATION]), steps), steps),
            _bounded(horizon_weights(fit(moves[:, POSITION]), steps), steps),
        )
        return distribution(history, displacement(moves, weights), backtest(moves, weights, steps))


def prior() -> F64:
    """[ORDER] coefficients of a damped constant velocity, newest increment first."""
    coefficients = np.zeros(ORDER)
    coefficients[:2] = PRIOR_PERSISTENCE / 2
    return coefficients


def fit(moves: F64) -> F64:
    """[ORDER] coefficients for ``moves`` [N, 3], newest increment first."""
    start = prior()
    if len(moves) <= ORDER:
        return start
    windows = np.lib.stride_tricks.sliding_window_view(moves, ORDER, axis=0)[:-1, :, ::-1]  # [N - ORDER, 3, ORDER]
    rows, targets = windows.reshape(-1, ORDER), moves[ORDER:].reshape(-1)
    energy = float(np.mean(rows**2))
    if energy <= 1e-18:
        return start
    gram = rows.T @ rows + RIDGE * energy * np.eye(ORDER)
    return np.asarray(start + np.linalg.solve(gram, rows.T @ (targets - rows @ start)))


def horizon_weights(coefficients: F64, steps: float) -> F64:
    """[ORDER] weights of the displacement over ``steps`` grid steps (a fraction counts in part), by recursion."""
    state = np.eye(ORDER)  # row j: increment j steps ago, as a combination of the ORDER known ones
    total = np.zeros(ORDER)
    remaining = steps
    while remaining > 0:
        following = coefficients @ state
        total += following * min(1.0, remaining)
        state = np.concatenate([following[None], state[:-1]])
        remaining -= 1.0
    return total


def _bounded(weights: F64, steps: float) -> F64:
    """Weights scaled down so that no history is carried further than ``MAX_GROWTH`` times its largest increment."""
    reach = float(np.abs(weights).sum())
    limit = MAX_GROWTH * steps
    return weights if reach <= limit or reach == 0 else weights * (limit / reach)
