"""Autoregression in the tangent space (the paper's predictor): fitted offline over many people, refitted online.

Offline, a ridge regression over recorded walks gives the displacement over each horizon from the last increments
(:mod:`cags_server.predict.pooled`; ``cags-train predictor``). Online, two gains, one for the rotation and one for the
position, are refitted to this viewer by ridge regression towards 1: some people turn more abruptly than others. The
history is short, so the pull towards 1 is strong; on recorded walks more freedom made predictions worse.
"""

from __future__ import annotations

import numpy as np

from cags_common import so3
from cags_common.geometry import F64
from cags_server.predict.base import PoseDistribution
from cags_server.predict.history import PoseHistory
from cags_server.predict.pooled import PooledWeights, displacements, windows
from cags_server.predict.tangent import (
    NEWEST_MATTER_STEPS,
    POSITION,
    ROTATION,
    STEP_US,
    WINDOW_POINTS,
    distribution,
    steps_of,
)

GAIN_RIDGE_STEPS = 600.0
"""Weight of the pull towards a gain of 1: so many grid steps of average motion (twenty seconds)."""

LEAST_MOTION = 1e-3
"""Least average motion that the pull assumes, radians and metres. While a viewer stands still, predictions are rounding
errors; without a floor, the gain would be a quotient of two sums of them once the viewer moves.
"""

MAX_GROWTH = 2.0
"""A predicted displacement is at most so many times what the fastest recent increment would cover in the horizon."""


class AutoregressivePredictor:
    """Pooled AR with online gains. ``weights`` are the shipped ones unless given."""

    def __init__(self, weights: PooledWeights | None = None) -> None:
        self._weights = weights or PooledWeights.shipped()

    def predict(self, history: PoseHistory, horizon_us: int) -> PoseDistribution:
        """See :class:`~cags_server.predict.base.Predictor`."""
        positions, rotations = history.on_grid(STEP_US, WINDOW_POINTS)
        steps = steps_of(horizon_us)
        order = self._weights.order_for(len(rotations) - 1)
        if order == 0 or steps == 0:
            return distribution(history, np.zeros(6), np.zeros(6))
        rows = windows(rotations, positions, order)
        guess = rows[-1] @ self._weights.at(order, steps)
        gains, std = self._refit(rotations, positions, rows, order, steps)
        moved = _bounded(guess * gains, rows[-1].reshape(order, 6), steps)
        return distribution(history, _in_world(moved, rotations[-1]), std)

    def _refit(self, rotations: F64, positions: F64, rows: F64, order: int, steps: float) -> tuple[F64, F64]:
        """[6] gains and [6] standard deviations (position: world axes) from predictions whose outcome is known."""
        whole = max(1, round(steps))
        known = len(rows) - whole
        if known < 1:
            recent = rows[-1].reshape(order, 6)
            spread = np.sqrt(np.mean(recent**2, axis=0)) * steps
            spread[POSITION] = np.sqrt(np.mean(spread[POSITION] ** 2))  # directions are not told apart
            return np.ones(6), spread
        guesses = rows[:known] @ self._weights.at(order, float(whole))
        truths = displacements(rotations, positions, order, whole)
        age = np.exp(-np.arange(known - 1, -1, -1) / NEWEST_MATTER_STEPS)
        gains = np.ones(6)
        for part in (ROTATION, POSITION):
            energy = float(np.mean(guesses[:, part] ** 2)) * 3
            pull = GAIN_RIDGE_STEPS * max(energy, LEAST_MOTION**2)
            product = float(np.sum(guesses[:, part] * truths[:, part]))
            gains[part] = (product + pull) / (float(np.sum(guesses[:, part] ** 2)) + pull)
        errors = truths - guesses * gains
        errors[:, POSITION] = so3.rotate(rotations[order : order + known], errors[:, POSITION])
        return gains, np.sqrt(age @ errors**2 / age.sum()) * (steps / whole)


def _bounded(moved: F64, recent: F64, steps: float) -> F64:
    """``moved`` [6] scaled back to what the fastest increment of ``recent`` [order, 6] could cover, part by part."""
    out = moved.copy()
    for part in (ROTATION, POSITION):
        limit = MAX_GROWTH * steps * float(np.linalg.norm(recent[:, part], axis=1).max())
        size = float(np.linalg.norm(out[part]))
        if size > limit:
            out[part] *= limit / size
    return out


def _in_world(moved: F64, rotation: F64) -> F64:
    """Displacement in camera axes -> the layout of :func:`~cags_server.predict.tangent.distribution`."""
    return np.concatenate([moved[ROTATION], so3.rotate(rotation, moved[POSITION])])
