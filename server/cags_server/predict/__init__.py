"""Where will the viewer look? Predictors behind one seam, picked by name."""

from __future__ import annotations

from collections.abc import Callable

from cags_common.registry import Registry
from cags_server.predict.autoregressive import AutoregressivePredictor
from cags_server.predict.base import MAX_HORIZON_US, PoseDistribution, Predictor
from cags_server.predict.history import PoseHistory
from cags_server.predict.hold import HoldPredictor
from cags_server.predict.kalman import KalmanPredictor
from cags_server.predict.linear import LinearPredictor

PREDICTORS: Registry[Callable[[], Predictor]] = Registry(
    "predictor =",
    "cags.predictors",
    {
        "hold": HoldPredictor,
        "linear": LinearPredictor,
        "autoregressive": AutoregressivePredictor,
        "kalman": KalmanPredictor,
    },
)
"""Predictors by name."""


def create_predictor(name: str) -> Predictor:
    """The predictor called ``name``. Raises :class:`~cags_common.errors.ConfigError` for an unknown one."""
    return PREDICTORS.find(name)()


__all__ = [
    "MAX_HORIZON_US",
    "PREDICTORS",
    "PoseDistribution",
    "PoseHistory",
    "Predictor",
    "create_predictor",
]
