"""What a decoded picture says is lacking in what a client draws itself, and how far it is to be believed."""

from __future__ import annotations

import cv2
import numpy as np

from cags_common.geometry import F32

AROUND_PX = 3
"""Radius, in pixels, of the neighbourhoods in which a picture and the render from its camera are compared."""

NOISE_WEIGHT = 2.0
"""Weight of what coding has left, which is not the same everywhere."""

LEAST_POWER = 1e-9

LEAST_DETAIL = 1e-4
"""Variance of colours under which a neighbourhood has no detail."""


def layer(coded: F32, own: F32, error: float) -> F32:
    """What the decoded picture ``coded`` lays over the client's view.

    ``own`` is that view from the picture's camera; both are [h, w, 3] RGB in [0, 1]. ``error`` is the mean squared
    error that coding left in the picture (0: none). Returns [h, w, 4]: premultiplied colour in [-1, 1], and opacity in
    [0, 1].

    The picture counts as far as it differs from the view by more than coding's noise: with d the difference, by
    Wiener's share 1 - k error / mean d^2 of each neighbourhood. k is 2. The client's own error over the whole picture
    is about mean d^2 - error; where that is less than ``error``, k grows by their ratio, so that a picture which is
    poorer than the view says nothing.

    Of that share, own colours stay as far as their detail is the picture's, g = cov(own, coded) / var(own): at the
    display's size they have more of it. The rest, such as splats that have not followed the scene's motion, gives way
    to the picture (opacity 1 - g).
    """
    own = np.clip(own, 0.0, 1.0)
    coded = np.clip(coded, 0.0, 1.0)
    power = _product(own - coded, own - coded)
    over_own = max(float(power.mean()) - error, LEAST_POWER)
    noise = NOISE_WEIGHT * max(1.0, error / over_own) * error
    share = np.clip(1 - noise / np.maximum(_around(power), LEAST_POWER), 0.0, 1.0)
    own_mean, coded_mean = _around(own), _around(coded)
    spread = _around(_product(own, own)) - _product(own_mean, own_mean)
    together = _around(_product(own, coded)) - _product(own_mean, coded_mean)
    least = np.float32(max(error, LEAST_DETAIL))
    kept = np.clip((together + least) / np.maximum(spread + least, LEAST_POWER), 0.0, 1.0)
    out = np.empty((*share.shape, 4), np.float32)
    out[..., :3] = share[..., None] * (coded - kept[..., None] * own)
    out[..., 3] = share * (1 - kept)
    return out


def _product(a: F32, b: F32) -> F32:
    """Mean over the channels [h, w]."""
    return np.asarray(np.einsum("ijk,ijk->ij", a, b) / np.float32(3))


def _around(image: F32) -> F32:
    return np.asarray(cv2.blur(image, (2 * AROUND_PX + 1,) * 2))
