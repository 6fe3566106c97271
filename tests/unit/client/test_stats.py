"""Stages are timed by the clock that was given."""

from __future__ import annotations

from cags_client.stats import Stopwatch


def test_a_stage_is_told_in_milliseconds_and_the_newest_time_stays() -> None:
    now = iter([1.0, 1.25, 5.0, 5.002])
    timed = Stopwatch(lambda: next(now))
    with timed("decode"):
        pass
    assert timed.stages_ms == {"decode": 250.0}
    with timed("decode"):
        pass
    assert abs(timed.stages_ms["decode"] - 2.0) < 1e-9
