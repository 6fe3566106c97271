"""How much each splat counts when codebooks are trained: more where more of it is seen."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cags_common.geometry import F64, Camera
from cags_common.raster import Rasteriser
from cags_common.splats import Splats
from cags_encoder.views import contributions

VIEWS = 16

EXPONENT = 0.5
"""Of the contribution: its full weight would spend the codes on a few large splats (docs/codec.md has the table)."""

_FLOOR = 0.01
"""Mean contributions that are added to every splat's: one that no view shows counts too."""


def importance(samples: Splats, cameras: Sequence[Camera], rasteriser: Rasteriser) -> F64:
    """Weights [n] > 0 of ``samples`` [n] drawn by themselves: a subset of a scene shows about what the scene does."""
    seen = contributions(samples, cameras, rasteriser)
    mean = float(seen.mean())
    if mean <= 0:
        return np.ones(len(samples))
    weights: F64 = (seen / mean + _FLOOR) ** EXPONENT
    return weights
