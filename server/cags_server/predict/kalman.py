"""An error-state Kalman filter on SE(3), run over the raw samples at their own times.

Rotation and position each follow the same model: a velocity that dies out (time constant ``velocity_s``), driven by an
acceleration that dies out faster (``acceleration_s``; Singer 1970) and is itself driven by white noise. The nominal
state lives on SE(3) (unit quaternion and position, with velocity and acceleration in camera and world axes); the filter
estimates the error around it in the tangent space, and every correction is folded back by the exponential map.

All axes of a part share one noise, so their covariance is one 3 x 3 matrix (value, velocity, acceleration), and gains
depend on the sample times alone. The scale of all noises is measured from the innovations: it cancels in the gain, and
makes the uncertainty that of this viewer at this moment; who stands still has none.

Constants: random search over the walks of EyeNavGS people 01-08 for the error 100-300 ms ahead.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from cags_common import so3
from cags_common.geometry import F64
from cags_server.predict.base import MAX_HORIZON_US, PoseDistribution
from cags_server.predict.history import PoseHistory
from cags_server.predict.tangent import POSITION, ROTATION, distribution

WINDOW_US = 500_000
"""Samples older than this no longer matter."""

MIN_SPACING_US = 20_000
"""Faster input is thinned to this spacing."""

INNOVATION_MEMORY = 20.0
"""Innovations count with weights falling by 1/e in so many samples."""

INITIAL_COVARIANCE = (50.0, 500.0)
"""Of velocity and acceleration before the first sample, in units of the driving noise: nothing is known."""


@dataclass(frozen=True, slots=True)
class MotionModel:
    """Time constants in seconds; ``noise`` is the measurement variance relative to the driving noise."""

    velocity_s: float
    acceleration_s: float
    noise: float
    calibration: float
    """Ratio of the errors that real walks have to those that the model expects."""


ROTATION_MODEL = MotionModel(velocity_s=0.65, acceleration_s=0.024, noise=1.2e-9, calibration=1.0)
POSITION_MODEL = MotionModel(velocity_s=0.67, acceleration_s=0.22, noise=8e-8, calibration=1.0)


class KalmanPredictor:
    """Filters the last samples and extrapolates the estimated motion."""

    def predict(self, history: PoseHistory, horizon_us: int) -> PoseDistribution:
        """See :class:`~cags_server.predict.base.Predictor`."""
        times, positions, rotations = history.segment()
        rows = _thinned(times - times[-1])
        horizon_ms = min(max(horizon_us, 0), MAX_HORIZON_US) / 1000
        gaps_ms = np.diff(times[rows]) / 1000.0
        turned, turn_std = _rotation_ahead(rotations[rows], gaps_ms, horizon_ms)
        moved, move_std = _position_ahead(positions[rows], gaps_ms, horizon_ms)
        out, std = np.zeros(6), np.zeros(6)
        out[ROTATION], out[POSITION] = turned, moved
        std[ROTATION], std[POSITION] = turn_std, move_std
        return distribution(history, out, std)


def _thinned(ages_us: F64) -> list[int]:
    """Rows of the samples that are used: the newest, and earlier ones no closer than the spacing; oldest first."""
    rows, last = [len(ages_us) - 1], 0
    for row in range(len(ages_us) - 2, -1, -1):
        age = -int(ages_us[row])
        if age > WINDOW_US:
            break
        if age - last >= MIN_SPACING_US:
            rows.append(row)
            last = age
    return rows[::-1]


def _rotation_ahead(rotations: F64, gaps_ms: F64, horizon_ms: float) -> tuple[F64, F64]:
    """Rotation vector [3] from the newest sample to the horizon, and its standard deviations [3]."""
    covariance = _initial(ROTATION_MODEL)
    nominal, motion = rotations[0], np.zeros((2, 3))  # velocity and acceleration, camera axes
    scale = _Scale()
    for measured, gap_ms in zip(rotations[1:], gaps_ms, strict=True):
        transition, noise = _transition(ROTATION_MODEL, round(gap_ms))
        nominal = so3.multiply(nominal, so3.exp(transition[0, 1:] @ motion))
        motion = transition[1:, 1:] @ motion
        covariance = transition @ covariance @ transition.T + noise
        error = so3.log(so3.multiply(so3.conjugate(nominal), measured))
        gain, covariance = _corrected(covariance, ROTATION_MODEL, error, scale)
        nominal = so3.multiply(nominal, so3.exp(gain[0] * error))
        motion = motion + gain[1:, None] * error
    ahead, std = _ahead(covariance, motion, ROTATION_MODEL, horizon_ms, scale)
    rest = so3.log(so3.multiply(so3.conjugate(rotations[-1]), nominal)) if horizon_ms > 0 else np.zeros(3)
    return so3.log(so3.multiply(so3.exp(rest), so3.exp(ahead))), std


def _position_ahead(positions: F64, gaps_ms: F64, horizon_ms: float) -> tuple[F64, F64]:
    """Displacement [3] from the newest sample to the horizon (world axes), and its standard deviations [3]."""
    covariance = _initial(POSITION_MODEL)
    state = np.zeros((3, 3))  # offset from the first sample, velocity, acceleration; world axes
    scale = _Scale()
    for measured, gap_ms in zip(positions[1:], gaps_ms, strict=True):
        transition, noise = _transition(POSITION_MODEL, round(gap_ms))
        state = transition @ state
        covariance = transition @ covariance @ transition.T + noise
        error = measured - positions[0] - state[0]
        gain, covariance = _corrected(covariance, POSITION_MODEL, error, scale)
        state = state + gain[:, None] * error
    ahead, std = _ahead(covariance, state[1:], POSITION_MODEL, horizon_ms, scale)
    rest = positions[0] + state[0] - positions[-1] if horizon_ms > 0 else np.zeros(3)
    return rest + ahead, std


class _Scale:
    """Scale of the noises from normalised innovations, axis by axis; the newest count most."""

    def __init__(self) -> None:
        self._sum = np.zeros(3)
        self._weight = 0.0

    def observe(self, error: F64, variance: float) -> None:
        fade = float(np.exp(-1.0 / INNOVATION_MEMORY))
        self._sum = self._sum * fade + error**2 / variance
        self._weight = self._weight * fade + 1.0

    @property
    def value(self) -> F64:
        return self._sum / self._weight if self._weight else np.zeros(3)


def _initial(model: MotionModel) -> F64:
    return np.diag([model.noise, *INITIAL_COVARIANCE])


def _corrected(covariance: F64, model: MotionModel, error: F64, scale: _Scale) -> tuple[F64, F64]:
    """Kalman gain [3] for a measurement of the value, and the covariance [3, 3] after it."""
    variance = float(covariance[0, 0]) + model.noise
    scale.observe(error, variance)
    gain = covariance[:, 0] / variance
    after = covariance - np.outer(gain, covariance[0])
    return gain, (after + after.T) / 2


def _ahead(covariance: F64, motion: F64, model: MotionModel, horizon_ms: float, scale: _Scale) -> tuple[F64, F64]:
    """Displacement [3] of ``motion`` (velocity, acceleration) over the horizon, and its standard deviations [3]."""
    if horizon_ms <= 0:
        return np.zeros(3), np.zeros(3)
    transition, noise = _transition(model, max(1, round(horizon_ms)))
    variance = float((transition @ covariance @ transition.T + noise)[0, 0])
    return transition[0, 1:] @ motion, model.calibration * np.sqrt(scale.value * variance)


@lru_cache(maxsize=4096)
def _transition(model: MotionModel, gap_ms: int) -> tuple[F64, F64]:
    """State transition and driving-noise covariance [3, 3] over a time (Van Loan 1978)."""
    from scipy.linalg import expm

    drift = np.array([[0.0, 1.0, 0.0], [0.0, -1.0 / model.velocity_s, 1.0], [0.0, 0.0, -1.0 / model.acceleration_s]])
    block = np.zeros((6, 6))
    block[:3, :3], block[2, 5], block[3:, 3:] = -drift, 1.0, drift.T
    exponential = expm(block * (max(gap_ms, 1) / 1000.0))
    transition = exponential[3:, 3:].T
    return transition, transition @ exponential[:3, 3:]
