"""The correction that a decoded picture implies for a client's own render, and how far to trust it."""

from __future__ import annotations

import math

import cv2
import numpy as np

from cags_common.geometry import F32

AROUND_PX = 3
"""Radius, in pixels, of the neighbourhoods for comparing a picture with the render from its camera."""

NOISE_WEIGHT = 2.0
"""Weight of the coding error, which varies over the picture."""

MOST_DOUBTED = 0.01
"""Largest error that :func:`doubted` assumes: differences of a quarter of the range, as where splats are missing, still
count.
"""

LEAST_POWER = 1e-9

LEAST_DETAIL = 1e-4
"""Variance of colours below which a neighbourhood counts as without detail."""


def layer(coded: F32, own: F32, error: float) -> F32:
    """The layer that the decoded picture ``coded`` adds to the client's view.

    ``own`` is the client's render from the picture's camera; both are [h, w, 3] RGB in [0, 1]. ``error`` is the mean
    squared coding error of the picture. Returns [h, w, 4]: premultiplied colour in [-1, 1], and opacity in [0, 1].

    The picture counts where it differs from the render by more than the coding error. With d the difference, its weight
    in each neighbourhood is Wiener's share 1 - k error / mean d^2. k is 2. The client's own error over the whole
    picture is about mean d^2 - error; if that is less than ``error``, k grows by their ratio, so that a picture that is
    poorer than the render has no effect.

    The client's own colours stay to the extent that the picture shares their detail, g = cov(own, coded) / var(own),
    because they have more detail at the display's resolution. The rest, such as splats that have not followed the
    scene's motion, is replaced by the picture (opacity 1 - g).
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


def doubted(error: float, own_error: float) -> float:
    """The ``error`` to pass to :func:`layer` for a picture of an earlier frame whose coding left ``error``, where the
    client's splats are expected to have ``own_error`` (NaN: unknown). All are mean squares of RGB in [0, 1].

    Splats that are better than the picture differ from it because some are missing or because the scene has moved on.
    :func:`layer` would mistake that motion for an error of the splats and add the picture's coding error everywhere.
    The error is therefore multiplied by the ratio of the two, in steps of an octave.
    """
    if not 0 <= own_error < error:
        return error
    octaves = round(math.log2(error / max(own_error, LEAST_POWER)))
    return max(error, min(error * 2.0**octaves, MOST_DOUBTED))


def _product(a: F32, b: F32) -> F32:
    """Mean over the channels [h, w]."""
    return np.asarray(np.einsum("ijk,ijk->ij", a, b) / np.float32(3))


def _around(image: F32) -> F32:
    return np.asarray(cv2.blur(image, (2 * AROUND_PX + 1,) * 2))
