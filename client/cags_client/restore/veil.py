"""Veils: a splat so close to a camera that it lies over much of its picture (a wall that is walked through, haze).

A few centimetres further on such a splat weighs another amount, and so does what quantisation did to it: what the
reference tells of it is true of the reference's view alone. Two things tell a veil from an error of the whole scene:

- no veil without a splat that makes up much of the picture (:func:`suspicion`): its compositing weights, summed over
  the client's own view of the reference, tell;
- a veil lies over splats at full LoD too, in which there is next to nothing to correct, as is known
  (:mod:`cags_client.expected`). Where *most* of the picture is corrected by far more than may be wrong there
  (:func:`plausible`), the excess is the veil's. Where a part of it is, parts of the scene are missing or have moved on,
  which no LoD tells: their corrections are sound.
"""

from __future__ import annotations

import numpy as np

from cags_client.restore.local import correction_power, local_mean
from cags_common.geometry import F32
from cags_common.video.noise import VOID_POWER

STARTS, CERTAIN = 0.06, 0.12
"""Share of a picture that one splat makes up, from which on a veil is looked for, and is with full weight. Of 429 views
under 0.12 four lost anything without a guard, and as much with it; above, up to 13 dB were lost."""

USUAL_ERROR = 0.2
"""Error of a colour channel (0..1) at the lowest LoD that quantisation seldom goes beyond."""

TIGHT_BELOW = 0.1
"""Expected error, as a share of the lowest LoD's, above which it says ever less: it is a mean, and errors are not."""

FROM_AREA, ALL_AREA = 0.3, 0.5
"""Share of the picture with more correction than is plausible, from which on it is reduced there, and is in full."""

LEAST_POWER = np.float32(1e-12)


def suspicion(contribution: F32 | None, pixels: int) -> float:
    """In [0, 1], from the splats' ``contribution`` [N] to a picture of so many pixels; 1 where it is not known."""
    if contribution is None:
        return 1.0
    share = float(contribution.max(initial=0.0)) / pixels
    return min(max((share - STARTS) / (CERTAIN - STARTS), 0.0), 1.0)


def plausible(fields: F32, own: F32, reference: F32, expected: F32) -> F32:
    """``fields`` [h, w, 4] of a correction of ``own`` by ``reference`` [h, w, 3], less what a veil has added.

    ``expected`` [h, w] is what may be wrong in ``own``, as a share of the lowest LoD's error.
    """
    power, share = correction_power(fields, own), local_mean(expected)
    usual = np.float32(USUAL_ERROR) * share * (1 + np.square(share / np.float32(TIGHT_BELOW)))
    weight = np.reciprocal(1 + np.square(power / np.maximum(3 * np.square(usual), LEAST_POWER)))
    seen = np.square(own).sum(axis=2) + np.square(reference).sum(axis=2) > VOID_POWER
    area = float((1 - weight)[seen].mean()) if seen.any() else 0.0
    excess = np.float32(min(max((area - FROM_AREA) / (ALL_AREA - FROM_AREA), 0.0), 1.0))
    if not excess:
        return fields
    return np.asarray(fields * (1 - excess * (1 - weight))[..., None], dtype=np.float32)
