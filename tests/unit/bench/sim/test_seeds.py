"""Seeds: other walks and other parts of a trace, the same for whatever is compared."""

from pathlib import Path

import numpy as np
import pytest

from cags_bench.sim.seeds import share_of, trace_of, walk_of
from cags_common.errors import TraceError
from cags_common.poses import Focus, open_poses, write_poses
from cags_shaper.trace import open_trace

FOCUS = Focus((0.0, 0.0, 0.0), 1.0, (0.0, 1.0, 0.0))
WINDOW_US = 2_000_000


@pytest.mark.parametrize("spec", ["generated:step", "generated:lte-driving", "generated:steady-30"])
@pytest.mark.parametrize("seed", [1, 2, 7])
def test_a_trace_is_turned_and_loses_nothing(spec: str, seed: int) -> None:
    whole, turned = open_trace(spec), trace_of(open_trace(spec), seed)
    assert turned.period_ms == whole.period_ms
    assert turned.opportunities == whole.opportunities
    start_us = round(share_of(seed) * whole.period_ms) * 1000
    for at in range(0, whole.duration_us, whole.duration_us // 7):
        expected = whole.count_until(start_us + at) - whole.count_until(start_us)
        assert turned.count_until(at) == expected


def test_seed_nought_is_what_is_named() -> None:
    trace = open_trace("generated:step")
    assert trace_of(trace, 0) is trace
    named, played = open_poses("synthetic:walking", FOCUS), walk_of("synthetic:walking", FOCUS, WINDOW_US, 0)
    assert np.array_equal(named.positions, played.positions)


def test_seeds_of_a_synthetic_walk_count_on_from_its_own() -> None:
    third = open_poses("synthetic:walking:seed=5", FOCUS)
    for spec, seed in (("synthetic:walking", 5), ("synthetic:walking:seed=3", 2)):
        assert np.array_equal(walk_of(spec, FOCUS, WINDOW_US, seed).positions, third.positions)


def test_seeds_of_a_recorded_walk_are_its_later_parts(tmp_path: Path) -> None:
    write_poses(open_poses("synthetic:walking", FOCUS), tmp_path / "walk.csv")
    starts = [walk_of(str(tmp_path / "walk.csv"), FOCUS, WINDOW_US, seed).positions[0] for seed in range(4)]
    assert len({tuple(np.round(start, 6)) for start in starts}) == 4


def test_seeds_lie_apart() -> None:
    shares = sorted(share_of(seed) for seed in range(8))
    assert min(np.diff([*shares, 1.0])) > 0.05


def test_a_walk_that_is_none_is_refused() -> None:
    with pytest.raises(TraceError, match="synthetic:walking:seed=x"):
        walk_of("synthetic:walking:seed=x", FOCUS, WINDOW_US, 1)
