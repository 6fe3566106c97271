"""What ``cags-bench align --ages`` accepts, and how its gains are taken."""

import math

import pytest

from cags_bench.align.ages import gains
from cags_bench.align.command import AlignBenchSettings
from cags_common.errors import ConfigError


def test_ages_are_sorted_and_each_comes_once() -> None:
    assert AlignBenchSettings(ages="10,1,3,1").age_list == [1, 3, 10]


@pytest.mark.parametrize("text", ["0", "1,", "-1", "a", "1.5", "1000"])
def test_other_ages_are_named(text: str) -> None:
    with pytest.raises(ConfigError, match="ages"):
        AlignBenchSettings(ages=text)


def test_gains_leave_out_frames_in_which_nothing_moves() -> None:
    def record(restored: float) -> dict[str, float]:
        return {"psnr_moving_restored_db": restored, "psnr_moving_distorted_db": 20.0}

    assert gains([record(21.0), record(math.nan), record(24.0)], "moving") == (2.5, 1.0)
    assert all(map(math.isnan, gains([record(math.nan)], "moving")))
