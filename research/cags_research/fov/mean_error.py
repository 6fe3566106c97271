"""The field of view as published (the paper, section 4.4): the network is trained by mean absolute error.

The server's own network has the same inputs and roll-out, but is trained so that its margins suffice in nine frames of
ten, and its answer is scaled. Here the answer is taken as it is: in about half of the frames the margin is too small.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

from cags_server.fov import FovOptions
from cags_server.fov.lstm import LstmFov, LstmWeights

SHIPPED = Path(__file__).parent / "weights" / "lstm-mean-error.npz"


def create(options: FovOptions) -> LstmFov:
    """The policy ``lstm-mean-error``. None of the ``options`` applies. Raises :class:`ConfigError` for bad weights."""
    return LstmFov(1.0, weights())


@cache
def weights() -> LstmWeights:
    """The shipped weights, read once. Raises :class:`~cags_common.errors.ConfigError` if they cannot be read."""
    return LstmWeights.load(SHIPPED)
