"""How far a step between both cameras lets a correction be carried over.

Colours are compared in the reference's view and brought over by the client's depth. Under a small step what is wrong
there is wrong here too, and lands in the right place to a fraction of a pixel. Seen from another side, silhouettes that
quantisation has frayed cover something else, and the correction of what they covered there is painted over what they
cover here. That is no matter of depth alone (the true one helps little), and the two own views need not differ in it.
"""

from __future__ import annotations

import cv2
import numpy as np

from cags_client.align.base import Reprojection
from cags_common.geometry import F32

HALF_AT = 0.29
"""Step between the cameras, as a share of a pixel's depth, at which half of a correction is left: 16 degrees."""

FROM = 0.17
"""Less leaves nearly everything (98.6 %), and nothing is worked out for pictures without any more."""

LOOKED_AT = 4
"""Every so many pixels and rows are looked at for whether anything is that near."""

WORKED_OUT = 2
"""Every so many pixels and rows the share is worked out; the others take their neighbour's."""


def kept(geometry: Reprojection) -> F32 | None:
    """Share [H, W] in [0, 1] of corrections that counts, 1 / (1 + (step / depth / HALF_AT)^8); None for all of all."""
    there, here = geometry.reference.pose.position, geometry.camera.pose.position
    step = np.float32(np.linalg.norm(np.subtract(there, here)))
    sampled = geometry.depth[::LOOKED_AT, ::LOOKED_AT]
    if not (step > np.float32(FROM) * sampled[sampled > 0]).any():
        return None
    depth = geometry.depth[::WORKED_OUT, ::WORKED_OUT]
    known = np.where(depth > 0, depth, np.float32(np.inf))
    ratio = np.minimum(step / np.float32(HALF_AT) / known, np.float32(1e4))  # whose 8th power is finite
    for _ in range(3):
        ratio *= ratio
    ratio += 1
    share, size = np.reciprocal(ratio, out=ratio), geometry.depth.shape[::-1]
    return np.asarray(cv2.resize(share, size, interpolation=cv2.INTER_NEAREST), dtype=np.float32)
