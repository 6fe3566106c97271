"""Where will the viewer look? Predictors behind one seam, picked by name."""

from __future__ import annotations

from collections.abc import Callable

from cags_common.errors import ConfigError
from cags_server.predict.autoregressive import AutoregressivePredictor
from cags_server.predict.base import MAX_HORIZON_US, PoseDistribution, Predictor
from cags_server.predict.history import PoseHistory
from cags_server.predict.hold import HoldPredictor
from cags_server.predict.kalman import KalmanPredictor
from cags_server.predict.linear import LinearPredictor

PREDICTORS: dict[str, Callable[[], Predictor]] = {
    "hold": HoldPredictor,
    "linear": LinearPredictor,
    "autoregressive": AutoregressivePredictor,
    "kalman": KalmanPredictor,
}
"""Every predictor by name."""


def create_predictor(name: str) -> Predictor:
    """The predictor called ``name``. Raises :class:`ConfigError` for an unknown one."""
    if name not in PREDICTORS:
        raise ConfigError(f"predictor = {name!r} is unknown; known: {', '.join(PREDICTORS)}")
    return PREDICTORS[name]()


__all__ = [
    "MAX_HORIZON_US",
    "PREDICTORS",
    "PoseDistribution",
    "PoseHistory",
    "Predictor",
    "create_predictor",
]
