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
    """What is to be laid over the client's view where it looks like ``own`` [h, w, 3]: [h, w, 4], a colour in [-1, 1],
    premultiplied, and an opacity in [0, 1], by the picture ``coded`` [h, w, 3].

    ``error`` is the mean squared error that coding has left ([0, 1] RGB; 0: none). In a neighbourhood where the two
    differ by d, the picture counts as far as this is more than coding's noise: 1 - k error / mean d^2 (Wiener's share),
    of which nothing is left where the client's own view is as good as the picture. k is 2; where the client's own error
    over the whole picture, mean d^2 - error, is less than coding's, it is larger by their ratio: a picture that is
    poorer than the view says less of it, and mostly errs where it seems to say something.

    Of that share, the own colours are kept as far as their detail is the picture's, g = cov(own, coded) / var(own) in
    the neighbourhood, since at the display's size they have more of it; what is wrong, such as splats that stand where
    they were, gives way to the picture (opacity 1 - g).
    """
    own = np.clip(own, 0.0, 1.0)
    coded = np.clip(coded, 0.0, 1.0)
    away, over_picture = _mean_square(own - coded)
    over_own = max(over_picture - error, LEAST_POWER)
    noise = NOISE_WEIGHT * max(1.0, error / over_own) * error
    share = np.clip(1 - noise / np.maximum(away, LEAST_POWER), 0.0, 1.0)
    own_mean, coded_mean = _around(own), _around(coded)
    spread = _around(_product(own, own)) - _product(own_mean, own_mean)
    together = _around(_product(own, coded)) - _product(own_mean, coded_mean)
    least = np.float32(max(error, LEAST_DETAIL))
    kept = np.clip((together + least) / np.maximum(spread + least, LEAST_POWER), 0.0, 1.0)
    out = np.empty((*share.shape, 4), np.float32)
    out[..., :3] = share[..., None] * (coded - kept[..., None] * own)
    out[..., 3] = share * (1 - kept)
    return out


def _mean_square(image: F32) -> tuple[F32, float]:
    """Around every pixel, and over the whole."""
    power = _product(image, image)
    return _around(power), float(power.mean())


def _product(a: F32, b: F32) -> F32:
    """Mean over the channels [h, w]."""
    return np.asarray(np.einsum("ijk,ijk->ij", a, b) / np.float32(3))


def _around(image: F32) -> F32:
    return np.asarray(cv2.blur(image, (2 * AROUND_PX + 1,) * 2))
