"""Units of motion, relative to a splat's size, which a client knows from the base code of its scale."""

from __future__ import annotations

import numpy as np

from cags_common.bundle.manifest import MotionSteps
from cags_common.coding.packing import U32
from cags_common.geometry import F64
from cags_common.splats import Splats

MOVE_STEP = 0.0625
"""Finest unit of positions, in standard deviations along a splat's middle axis."""

TURN_STEP = 0.05
"""Finest unit of rotations, radians, of a splat with two equal long axes."""

SMALL = 25.0
"""Percentile of all sizes. Smaller splats get the unit of this size: they are specks beside their neighbours."""

TYPICAL = 35.0
"""Percentile of the sizes with the same base code that determines their unit."""

LARGEST = 30.0
"""Log scales beyond it count as this: units have a largest value in the bundle."""

LEAST_TURN = 0.05
"""Smallest ratio of middle to longest axis that makes the unit of rotations finer."""


def motion_steps(samples: Splats, base_codes: U32, codes: int) -> MotionSteps:
    """Units for each base code of scale, 0 to ``codes`` - 1, from ``samples`` [n] with ``base_codes`` [n]."""
    sizes = np.sort(np.exp(np.clip(samples.log_scales.astype(np.float64), -60, LARGEST)), axis=1)
    middle, slimness = sizes[:, 1], np.clip(sizes[:, 1] / np.maximum(sizes[:, 2], 1e-300), LEAST_TURN, 1.0)
    least = float(np.percentile(middle, SMALL))
    moves = [max(value, least) * MOVE_STEP for value in _by_code(middle, base_codes, codes, TYPICAL)]
    turns = [value * TURN_STEP / 2 for value in _by_code(slimness, base_codes, codes, TYPICAL)]
    return MotionSteps(tuple(map(_short, moves)), tuple(map(_short, turns)))


def _by_code(values: F64, base_codes: U32, codes: int, share: float) -> list[float]:
    typical = float(np.percentile(values, share))
    groups = (values[base_codes == code] for code in range(codes))
    return [float(np.percentile(group, share)) if len(group) else typical for group in groups]


def _short(value: float) -> float:
    """Rounded to float32, the precision of players."""
    return float(np.float32(value))
