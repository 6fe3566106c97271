"""Intervals of paired differences."""

import math

import numpy as np
import pytest

from cags_bench.confidence import BLOCK_FRAMES, interval, paired, pooled


def test_the_interval_is_students() -> None:
    found = interval([1.0, 2.0, 3.0])
    assert found.mean == 2.0
    assert found.high - found.mean == pytest.approx(4.30 / math.sqrt(3), rel=1e-3)
    assert found.mean - found.low == pytest.approx(found.high - found.mean)
    assert found.above(-0.5)
    assert not found.above(0.0), "it may be less"


@pytest.mark.parametrize(("count", "student"), [(2, 12.706), (5, 2.776), (30, 2.045), (200, 1.972)])
def test_fewer_observations_are_less_sure(count: int, student: float) -> None:
    values = np.random.default_rng(2).normal(size=count)
    found = interval(values.tolist())
    assert found.high - found.mean == pytest.approx(student * values.std(ddof=1) / math.sqrt(count), rel=1e-3)


def test_nineteen_in_twenty_intervals_hold_the_truth() -> None:
    rng = np.random.default_rng(1)
    held = [(found := interval(rng.normal(3.0, 1.0, 5).tolist())).low <= 3.0 <= found.high for _ in range(2000)]
    assert 0.93 < np.mean(held) < 0.97


def test_one_observation_is_sure_of_nothing() -> None:
    for values in ([5.0], [], [1.0, math.nan]):
        assert not interval(values).above(0.0)


def test_frames_that_are_alike_are_no_independent_observations() -> None:
    """A difference that comes and goes slowly, as alike neighbours have it: by frames it would look sure."""
    slow = np.repeat([2.0, -1.0, 1.5, -0.5], BLOCK_FRAMES)
    assert interval(slow.tolist()).above(0.0)
    assert not paired(slow, np.zeros_like(slow)).above(0.0)


def test_pairs_must_be_pairs() -> None:
    with pytest.raises(ValueError, match="3 frames of ours and 2 of theirs"):
        paired([1.0, 2.0, 3.0], [1.0, 2.0])


def test_plays_are_pooled_by_blocks() -> None:
    found = pooled([np.full(18, 1.0).tolist(), np.full(9, 4.0).tolist()])
    assert found.mean == 2.0
    assert not found.above(0.0)
