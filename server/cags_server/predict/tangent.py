"""Motion as increments in the tangent space, and prediction as a linear filter over them.

On a regular grid of ``STEP_US`` the motion is the sequence of increments: the rotation vector of ``R[k-1]^T R[k]``
(radians, in the camera's own axes) and the displacement of the position (world axes). Every linear predictor then is
one vector of weights a part: the displacement over the horizon is the weighted sum of the newest increments. Working
on increments needs no average of quaternions, has no gimbal, and does not see their sign.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cags_common import so3
from cags_common.geometry import F64, Pose
from cags_server.predict.base import MAX_HORIZON_US, PoseDistribution
from cags_server.predict.history import PoseHistory

STEP_US = 33_333
"""Grid of the increments: a frame at 30 fps."""

WINDOW_POINTS = 121
"""Points kept on the grid: four seconds."""

NEWEST_MATTER_STEPS = 30.0
"""Errors of the past count with weights falling by 1/e in so many steps (a second)."""

ROTATION, POSITION = slice(0, 3), slice(3, 6)


@dataclass(frozen=True, slots=True)
class Weights:
    """A linear predictor over one horizon: displacement = sum over j of weight[j] x increment (newest has j = 0)."""

    rotation: F64  # [J]
    position: F64  # [J]

    @classmethod
    def zero(cls) -> Weights:
        """Predicts that nothing moves."""
        return cls(np.zeros(1), np.zeros(1))


def increments(history: PoseHistory) -> F64:
    """[N, 6] increments of the last segment, oldest first: rotation vector (camera axes), displacement (world axes)."""
    positions, rotations = history.on_grid(STEP_US, WINDOW_POINTS)
    turned = so3.log(so3.multiply(so3.conjugate(rotations[:-1]), rotations[1:]))
    return np.concatenate([turned, np.diff(positions, axis=0)], axis=1)


def steps_of(horizon_us: int) -> float:
    """Horizon in grid steps, clamped to what a predictor answers for."""
    return min(max(horizon_us, 0), MAX_HORIZON_US) / STEP_US


def displacement(moves: F64, weights: Weights) -> F64:
    """[6] predicted displacement: the filter at the newest increments, missing ones counting as zero."""
    out = np.zeros(6)
    for part, weight in ((ROTATION, weights.rotation), (POSITION, weights.position)):
        newest_first = moves[::-1, part][: len(weight)]
        out[part] = weight[: len(newest_first)] @ newest_first
    return out


def backtest(moves: F64, weights: Weights, steps: float) -> F64:
    """[6] standard deviation of the filter's own error over this history, newest errors counting most.

    The filter is run at every past point of the grid whose future is known. Without a whole horizon of past, the
    recent motion itself, held over the horizon, stands in for the error.
    """
    whole = max(1, round(steps))
    count = len(moves) - whole  # origins with a known future
    if steps == 0 or len(moves) == 0:
        return np.zeros(6)
    if count < 1:
        return np.asarray(np.sqrt(np.mean(moves**2, axis=0)) * steps)
    sums = np.concatenate([np.zeros((1, 6)), np.cumsum(moves, axis=0)])
    future = sums[1 + whole :] - sums[1 : 1 + count]  # origin i is the point after increment i
    guesses = np.concatenate(
        [_filtered(moves[:count, ROTATION], weights.rotation), _filtered(moves[:count, POSITION], weights.position)],
        axis=1,
    )
    age = np.exp(-np.arange(count - 1, -1, -1) / NEWEST_MATTER_STEPS)
    errors = future * (steps / whole) - guesses
    return np.asarray(np.sqrt(age @ errors**2 / age.sum()))


def _filtered(moves: F64, weight: F64) -> F64:
    padded = np.concatenate([np.zeros((len(weight) - 1, moves.shape[1])), moves])
    windows = np.lib.stride_tricks.sliding_window_view(padded, len(weight), axis=0)  # [N, 3, J], oldest first
    return np.asarray(windows @ weight[::-1])


def distribution(history: PoseHistory, moved: F64, std: F64) -> PoseDistribution:
    """The newest pose moved by ``moved`` [6] (increment layout) with standard deviations ``std`` [6]."""
    pose = history.newest.pose
    rotation = so3.multiply(np.array(pose.rotation), so3.exp(moved[ROTATION]))
    position = np.array(pose.position) + moved[POSITION]
    predicted = Pose(
        (float(position[0]), float(position[1]), float(position[2])),
        (float(rotation[0]), float(rotation[1]), float(rotation[2]), float(rotation[3])),
    )
    s = [float(value) for value in std]
    return PoseDistribution(predicted, (s[0], s[1], s[2]), (s[3], s[4], s[5]))
