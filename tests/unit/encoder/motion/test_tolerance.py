"""The tolerance of motion."""

import numpy as np

from cags_common.motion.chunk import LEVELS, REFINEMENT
from cags_encoder.motion.chunks import BASE_LEVELS, COARSE, exactness
from cags_encoder.motion.tolerance import Tolerance, Tolerances


def waves(size: float) -> tuple[np.ndarray, np.ndarray]:
    """Samples [17, 200, 3] in units, and a mask that marks all as present."""
    random = np.random.default_rng(0)
    values = size * np.sin(np.arange(17)[:, None, None] / 5 + random.uniform(0, 6, (1, 200, 3)))
    return values, np.ones((17, 200), bool)


def test_what_quantised_looks_hide_is_told_by_the_usual_units() -> None:
    found = exactness(*waves(40.0), Tolerance(8.0, 0.5, 0.1), starts=True, turn=False)
    assert (found.finer, found.told, found.coarse) == (COARSE, BASE_LEVELS, False)


def test_a_better_base_halves_the_units_and_leaves_out_what_it_makes_superfluous() -> None:
    usual = exactness(*waves(40.0), Tolerance(8.0, 0.5, 0.25), starts=True, turn=False)
    fine = exactness(*waves(40.0), Tolerance(0.5, 0.5, 0.25), starts=True, turn=False)
    assert fine.finer > usual.finer
    assert fine.told - fine.coarse < usual.told


def test_a_base_finer_than_splats_comes_after_a_coarser_level() -> None:
    fine = exactness(*waves(40.0), Tolerance(1.0, 0.01, 0.005), starts=True, turn=False)
    assert fine.coarse
    assert (fine.told, len(fine.deadzones)) == (LEVELS, LEVELS)
    assert REFINEMENT ** (LEVELS - 1) * 2.0**-fine.finer <= REFINEMENT ** (BASE_LEVELS - 1), "not coarser than a splat"


def test_motion_that_nobody_sees_is_told_by_one_level() -> None:
    assert exactness(*waves(40.0), Tolerance(1e3, 1e3, 1e3), starts=True, turn=False).told == 1


def test_where_little_moves_it_may_be_off_by_more() -> None:
    wide = Tolerances().over(0.25)
    assert wide.moves.base == 2 * Tolerance().base
    assert Tolerances().over(1.0) == Tolerances()
