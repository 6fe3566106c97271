"""The constants and rules that define a right picture, shared by the reference and the tests of all backends."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cags_common.splats import Splats

ALPHA_CUT = 1.0 / 255.0
"""A splat is not drawn at pixels where its alpha is less (Kerbl et al. 2023)."""

ALPHA_MAX = 0.99
"""A splat's alpha is capped, so that what lies behind is never lost at once (Kerbl et al. 2023)."""

JACOBIAN_MARGIN = 1.3
"""The projection is linearised at the splat's centre, held to this multiple of tan(FoV / 2) (Kerbl et al. 2023)."""

MAX_DEPTH = 1e12
"""Splats farther in front of the camera (world units) are not drawn: single precision ends there."""

MAX_SCALE = 1e7
"""Standard deviations (world units) are clamped to it, for the same reason."""


def content_hash(splats: Splats) -> NDArray[np.uint32]:
    """A 32-bit hash of each splat's content [N]: of two splats at one depth, the one with the smaller hash is in front.

    So a picture does not depend on the order in which a scene lists its splats. FNV-1a over the attributes' words,
    those that motion changes last, then a finaliser.
    """
    state = np.full(len(splats), 2166136261, np.uint32)
    for array in (splats.log_scales, splats.sh0, splats.sh_rest, splats.means, splats.quats, splats.logit_opacities):
        for column in array.reshape(len(splats), array[:1].size if len(splats) else 0).T:
            state = (state ^ np.ascontiguousarray(column, np.float32).view(np.uint32)) * np.uint32(16777619)
    state = (state ^ (state >> np.uint32(15))) * np.uint32(0x2C1B3C6D)
    return state ^ (state >> np.uint32(12))
