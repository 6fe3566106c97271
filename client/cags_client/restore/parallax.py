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
from cags_client.restore.local import correction_power
from cags_common.geometry import F32

HALF_AT = 0.29
"""Step between the cameras, as a share of a pixel's depth, at which half of a correction is left: 16 degrees."""

FROM = 0.17
"""Less leaves nearly everything (98.6 %), and nothing is worked out for pictures without any more."""

LOOKED_AT = 4
"""Every so many pixels and rows are looked at for whether anything is that near."""

WORKED_OUT = 2
"""Every so many pixels and rows the share is worked out; the others take their neighbour's."""

MISSING_POWER = 0.35
"""Local power of a correction, over three channels in 0..1, that stands for something missing."""

MISSING_STEP, PLACED_FROM = 0.1, 0.03
"""Step as a share of the depth at which half of such a correction is left; that under which it is in place."""


def kept(geometry: Reprojection) -> F32 | None:
    """Share [H, W] in [0, 1] of corrections that counts, 1 / (1 + (step / depth / HALF_AT)^8); None for all of all."""
    step = np.float32(_step(geometry))
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


def relative_step(geometry: Reprojection) -> float:
    """The step between both cameras as a share of the median depth of the client's view; 0 for a view of nothing."""
    sampled = geometry.depth[::LOOKED_AT, ::LOOKED_AT]
    known = sampled[(sampled > 0) & np.isfinite(sampled)]
    return float(_step(geometry) / np.median(known)) if known.size else 0.0


def placed(fields: F32, own: F32, step: float) -> F32:
    """``fields`` [h, w, 4] of a correction of ``own`` [h, w, 3], less what lands in a wrong place after a ``step``.

    Corrections beyond what quantisation does stand for something that is missing. It is placed by the depth of what
    lies behind it, so the further the reference stands aside, the more of it is left out:
    1 / (1 + (power / MISSING_POWER)^2 (step / MISSING_STEP)^4).
    """
    power = correction_power(fields, own)
    weight = np.reciprocal(1 + np.square(power * np.float32((step / MISSING_STEP) ** 2 / MISSING_POWER)))
    return np.asarray(fields * weight[..., None], dtype=np.float32)


def _step(geometry: Reprojection) -> float:
    """Between both cameras, in the scene's unit."""
    there, here = geometry.reference.pose.position, geometry.camera.pose.position
    return float(np.linalg.norm(np.subtract(there, here)))
