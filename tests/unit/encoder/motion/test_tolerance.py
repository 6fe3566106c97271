"""The tolerance of motion."""

from itertools import pairwise

import numpy as np
import pytest

from cags_common.motion.chunk import LEVELS, REFINEMENT
from cags_encoder.motion.chunks import (
    BASE_LEVELS,
    BASE_ZONES,
    COARSE,
    JUDGED,
    LAST_ZONES,
    RUN,
    Trajectories,
    exactness,
    some,
)
from cags_encoder.motion.tolerance import Tolerance, Tolerances
from support.anchors import scattered


def waves(size: float) -> tuple[Trajectories, np.ndarray]:
    """Samples [17, 200, 3] in units, and a mask that marks all as present."""
    random = np.random.default_rng(0)
    values = size * np.sin(np.arange(17)[:, None, None] / 5 + random.uniform(0, 6, (1, 200, 3)))
    return Trajectories(values, scattered(200), True, False), np.ones((17, 200), bool)


def test_what_quantised_looks_hide_is_told_by_the_usual_units() -> None:
    found = exactness(*waves(40.0), Tolerance(8.0, 0.5, 0.1))
    assert (found.finer, found.told, found.coarse) == (COARSE, BASE_LEVELS, False)


def test_a_better_base_halves_the_units_and_leaves_out_what_it_makes_superfluous() -> None:
    usual = exactness(*waves(40.0), Tolerance(8.0, 0.5, 0.25))
    fine = exactness(*waves(40.0), Tolerance(0.5, 0.5, 0.25))
    assert fine.finer > usual.finer
    assert fine.told - fine.coarse < usual.told


def test_a_base_finer_than_splats_comes_after_a_coarser_level() -> None:
    fine = exactness(*waves(40.0), Tolerance(1.0, 0.01, 0.005))
    assert fine.coarse
    assert (fine.told, len(fine.deadzones)) == (LEVELS, LEVELS)
    assert REFINEMENT ** (LEVELS - 1) * 2.0**-fine.finer <= REFINEMENT ** (BASE_LEVELS - 1), "not coarser than a splat"


def test_motion_that_nobody_sees_is_told_by_one_level() -> None:
    assert exactness(*waves(40.0), Tolerance(1e3, 1e3, 1e3)).told == 1


def test_the_few_that_move_are_not_hidden_by_the_many_that_stand() -> None:
    """A mobile hung askew in a room of which most stood still: its tile had one level of motion."""
    few, present = waves(40.0)
    count, still = few.values.shape[1], 40
    values = np.zeros((len(few.values), still * count, 3))
    values[:, ::still] = few.values
    many = Trajectories(values, scattered(still * count), few.starts, few.turn)
    tolerance = Tolerance(8.0, 0.5, 0.9)
    alone = exactness(few, present, tolerance)
    among = exactness(many, np.ones(values.shape[:2], bool), tolerance)
    assert alone.told > 1
    assert (among.told, among.finer) >= (alone.told, alone.finer)


def test_dead_zones_are_the_widest_that_the_tolerance_allows() -> None:
    found = [exactness(*waves(40.0), Tolerance(base, 0.5, 0.1)) for base in np.linspace(4.2, 8.0, 12)]
    assert {each.zones[0] for each in found} <= set(BASE_ZONES) and {each.zones[-1] for each in found} <= set(
        LAST_ZONES
    )
    for tighter, looser in pairwise(found):
        assert tighter.finer > looser.finer or tighter.zones[0] <= looser.zones[0]
    assert len({each.zones[0] for each in found}) > 1 == len({each.finer for each in found})


@pytest.mark.parametrize("count", [0, 1, JUDGED, 2 * JUDGED - 1, 2 * JUDGED, 10 * JUDGED])
def test_splats_are_judged_by_in_runs_of_neighbours(count: int) -> None:
    rows = 3 * np.arange(count)
    chosen = some(rows)
    assert np.isin(chosen, rows).all() and (np.diff(chosen) > 0).all()
    assert len(chosen) == count if count < 2 * JUDGED else JUDGED <= len(chosen) < JUDGED + RUN
    breaks = np.flatnonzero(np.diff(chosen) != 3) + 1
    assert (breaks % RUN == 0).all()


def test_where_little_moves_it_may_be_off_by_more() -> None:
    wide = Tolerances().over(0.25)
    assert wide.moves.base == 2 * Tolerance().base
    assert Tolerances().over(1.0) == Tolerances()
