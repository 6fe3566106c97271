"""Weights of splats in codebook training: the larger a splat's contribution to pictures, the larger its weight."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cags_common.geometry import F64, Camera
from cags_common.raster import Rasteriser
from cags_common.splats import Splats
from cags_encoder.views import contributions

VIEWS = 16

EXPONENT = 0.5
"""Exponent of the contribution: with 1, a few large splats would take most codes (table in docs/lab/codec.md)."""

_FLOOR = 0.01
"""Added to every splat's contribution, in mean contributions, so that splats in no view count too."""


def importance(samples: Splats, cameras: Sequence[Camera], rasteriser: Rasteriser) -> F64:
    """Weights [n] > 0 of ``samples`` [n], from renders of the samples alone, which resemble the scene."""
    seen = contributions(samples, cameras, rasteriser)
    mean = float(seen.mean())
    if mean <= 0:
        return np.ones(len(samples))
    weights: F64 = (seen / mean + _FLOOR) ** EXPONENT
    return weights
