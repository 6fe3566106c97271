"""What a viewer notices beside single pictures."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_client.output.steadiness import steadiness

FRAME_US = 33_333


def records(latencies_ms: list[float], *, skipped: tuple[int, ...] = (), **series: list[float]) -> list[dict[str, Any]]:
    """A play at 30 frames a second without the frames ``skipped``."""
    frames = [frame for frame in range(len(latencies_ms) + len(skipped)) if frame not in skipped]
    return [
        {"frame": frame, "time_us": frame * FRAME_US, "latency_ms": late, "lod_mean": 3.0}
        | {name: values[index] for name, values in series.items()}
        for index, (frame, late) in enumerate(zip(frames, latencies_ms, strict=True))
    ]


@given(st.floats(0, 500), st.integers(2, 60))
def test_frames_that_are_equally_late_are_even(late_ms: float, count: int) -> None:
    figures = steadiness(records([late_ms] * count))
    assert figures["frames_per_s"] == pytest.approx(30, rel=1e-3)
    assert figures["even_share"] == 1
    assert figures["freezes"] == figures["frozen_ms"] == figures["level_falls"] == 0
    assert "psnr_restored_p5_db" not in figures


def test_a_picture_that_was_drawn_late_is_uneven_though_it_was_due_in_time() -> None:
    assert steadiness(records([0.0] * 10 + [30.0] + [0.0] * 9))["even_share"] == pytest.approx(18 / 19)


def test_skipped_frames_are_gaps_and_many_of_them_a_freeze() -> None:
    assert steadiness(records([0.0] * 30, skipped=(7,)))["freezes"] == 0
    frozen = steadiness(records([0.0] * 30, skipped=tuple(range(10, 20))))
    assert frozen["freezes"] == 1
    assert frozen["frozen_ms"] == pytest.approx(11 * FRAME_US / 1e3)


def test_frames_skipped_at_the_start_are_a_gap() -> None:
    """A play that showed two frames of fifteen, the last ones, was said to be steady at 66 frames a second."""
    last = records([60.0, 10.0], skipped=(*range(12), 13))
    figures = steadiness(last, 0)
    assert figures["frames_per_s"] == pytest.approx(2e3 / (14 * FRAME_US / 1e3 + 10))
    assert (figures["even_share"], figures["gap_p95_ms"] > 400) == (0.5, True)
    assert steadiness(last[:1], 0)["even_share"] == 0
    whole = records([20.0] * 30)
    assert steadiness(whole, 0) == steadiness(whole), "frames that are equally late are even"


def test_steps_are_between_pictures_that_follow_each_other() -> None:
    steady = [40.0] * 20
    assert steadiness(records([0.0] * 20, psnr_restored_db=steady))["psnr_restored_step_p95_db"] == 0
    jumping = [40.0, 36.0] * 10
    figures = steadiness(records([0.0] * 20, psnr_restored_db=jumping))
    assert figures["psnr_restored_step_p95_db"] == 4
    assert figures["psnr_restored_p5_db"] == 36
    every_other = [40.0, math.nan] * 10
    assert "psnr_restored_step_p95_db" not in steadiness(records([0.0] * 20, psnr_restored_db=every_other))


def test_a_fall_of_the_level_is_counted_and_a_rise_is_not() -> None:
    play = records([0.0] * 6)
    for record, level in zip(play, (1.0, 3.0, 2.9, 2.0, 2.0, 5.0), strict=True):
        record["lod_mean"] = level
    assert steadiness(play)["level_falls"] == 1


@pytest.mark.parametrize("count", [0, 1])
def test_there_is_nothing_to_tell_of_fewer_than_two_pictures(count: int) -> None:
    assert steadiness(records([0.0] * count)) == steadiness(records([0.0] * count), 0) == {}
