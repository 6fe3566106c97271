"""How far a decoded picture is to be trusted against what a client draws itself."""

from __future__ import annotations

import cv2
import numpy as np

from cags_common.geometry import F32

AROUND_PX = 3
"""Radius, in pixels, of the neighbourhoods in which a picture and the render from its camera are compared."""

NOISE_WEIGHT = 2.0
"""Weight of what coding has left, which is not the same everywhere."""

LEAST_POWER = 1e-9


def trusted(coded: F32, own: F32, error: float) -> F32:
    """The picture ``coded`` [h, w, 3] as far as it differs from the client's ``own`` view of it by more than coding.

    ``error`` is the mean squared error that coding has left ([0, 1] RGB; 0: none, the picture counts whole). Where the
    two differ by no more than that, nothing is lacking: of the difference d in a neighbourhood 1 - error / mean d^2
    counts, Wiener's share.
    """
    if error <= 0:
        return coded
    own = np.clip(own, 0.0, 1.0)
    away = coded - own
    size = (2 * AROUND_PX + 1,) * 2
    power = cv2.boxFilter(np.einsum("ijk,ijk->ij", away, away), -1, size) / 3
    share = np.clip(1 - NOISE_WEIGHT * error / np.maximum(power, LEAST_POWER), 0.0, 1.0)
    return np.asarray(own + share[..., None] * away, np.float32)
