"""How far ``lite`` may move the closed form's fields, for every runtime: NumPy alone."""

from __future__ import annotations

import numpy as np

from cags_client.restore.affine import NOISE_FLOOR
from cags_common.geometry import F32

REACH = 0.5
"""How far a correction may be moved, in standard deviations of the coding noise: more is not the codec's doing. Weights
that were trained on another encoder's noise lost up to 7 dB in single crops without a bound; with it they cannot."""

FACTOR_REACH = 0.3
"""How far a factor may be moved."""

USUAL_DEVIATION = 0.03
"""Standard deviation of pictures within a window, about; the codec's noise grows with it."""


def colour_reach(noise: F32) -> float:
    """How far a correction may be moved, in [0, 1], under coding noise of these features [6]."""
    variance = np.power(10.0, noise.astype(np.float64) - 4.0)
    fine, broad = variance[:3].mean(), variance[3:].mean()
    return REACH * float(np.sqrt(broad + USUAL_DEVIATION * fine + NOISE_FLOOR))
