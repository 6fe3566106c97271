"""What ``cags-bench align --ages`` and ``--size`` accept."""

import math

import pytest

from cags_bench.align.ages import _ages, gains
from cags_bench.references import size_of
from cags_common.errors import ConfigError


def test_ages_are_sorted_and_each_comes_once() -> None:
    assert _ages("10,1,3,1") == [1, 3, 10]


@pytest.mark.parametrize("text", ["0", "1,", "-1", "a", "1.5", "1000"])
def test_other_ages_are_named(text: str) -> None:
    with pytest.raises(ConfigError, match="ages"):
        _ages(text)


def test_sizes() -> None:
    assert size_of("800x600") == (800, 600)
    with pytest.raises(ConfigError, match="800 by 600"):
        size_of("800 by 600")


def test_gains_leave_out_frames_in_which_nothing_moves() -> None:
    def record(restored: float) -> dict[str, float]:
        return {"psnr_moving_restored_db": restored, "psnr_moving_distorted_db": 20.0}

    assert gains([record(21.0), record(math.nan), record(24.0)], "moving") == (2.5, 1.0)
    assert all(map(math.isnan, gains([record(math.nan)], "moving")))
