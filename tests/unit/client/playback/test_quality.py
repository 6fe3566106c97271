"""What a device does with its time: on machines that are functions of what is chosen."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cags_client.playback.quality import (
    DOWN_AFTER_US,
    HEADROOM,
    SCALES,
    UP_AFTER_MOST_US,
    UP_AFTER_US,
    UP_SHARE,
    Quality,
    newest_due,
    next_due,
)
from cags_client.settings import AUTO, FULL, HALF, OFF, ON
from cags_protocol.cadence import EVERY_FRAME, LEAST_PERMILLE
from support.machine import PERIOD_US, Drawn, Machine

PAGE = (0.35, 0.5, 0.7, 1.0)
"""What the page chooses among."""


def made(
    scales: tuple[float, ...] = SCALES[AUTO], between: str = OFF, rate: float = 60.0, *, skips: bool = True
) -> Quality:
    quality = Quality(scales, 1e6 / rate, skips=skips)
    quality.period_us = PERIOD_US
    quality.wish(scales, between)
    return quality


def machine(fixed_ms: float, pixels_ms: float, quality: Quality | None = None, **more: object) -> Machine:
    return Machine(quality or made(), fixed_ms * 1e3, pixels_ms * 1e3, **more)  # type: ignore[arg-type]


def ticks(drawn: list[Drawn]) -> list[int]:
    return [each.tick for each in drawn if each.media]


def changes(drawn: list[Drawn]) -> list[float]:
    """When the next picture was to be another than the one before."""
    return [b.done_us for a, b in pairwise(drawn) if a[3:] != b[3:]]


# ------------------------------------------------------------------------------------------------------ order of worth


def test_a_quick_machine_draws_everything_from_the_beginning() -> None:
    of = machine(2.0, 8.0)
    drawn = of.play(20)
    assert ticks(drawn) == list(range(len(ticks(drawn))))
    assert {(each.scale, each.permille, each.step_us) for each in drawn} == {(1.0, EVERY_FRAME, None)}


def test_pixels_go_before_frames() -> None:
    of = machine(5.0, 54.0)
    of.play(2)
    drawn = of.play(30)
    assert {(each.scale, each.permille) for each in drawn} == {(0.5, EVERY_FRAME)}
    assert all(b - a == 1 for a, b in pairwise(ticks(drawn))), "every media frame"


def test_frames_are_left_out_where_fewer_pixels_do_not_help() -> None:
    of = machine(50.0, 0.1)
    of.play(2)
    drawn = of.play(20)
    assert {each.scale for each in drawn} == {1.0}
    (permille,) = {each.permille for each in drawn}
    assert PERIOD_US / 50.1e3 * 0.97 <= permille / EVERY_FRAME <= PERIOD_US / 50.1e3 * 1.1
    assert {b - a for a, b in pairwise(ticks(drawn))} == {1, 2}, "evenly"


def test_pixels_stay_where_fewer_save_little_and_not_enough() -> None:
    """Updates of a clip whose splats all change took 60 ms and drawing 10, and half of the pixels were given up."""
    drawn = machine(60.0, 10.0).play(20)
    assert {each.scale for each in drawn} == {1.0}
    of = machine(28.0, 12.0)
    of.play(2)
    assert {(each.scale, each.permille) for each in of.play(20)} == {(0.5, EVERY_FRAME)}, "enough"
    of = machine(30.0, 40.0)
    of.play(2)
    assert {each.scale for each in of.play(20)} == {0.5}, "much"


def test_pixels_are_not_given_up_for_a_few_late_frames() -> None:
    """*monkey* lost 30 dB in half of its frames, and was displayed no more often."""
    of = machine(27.0, 10.0)
    drawn = of.play(20)
    assert {(each.scale, each.permille) for each in drawn} == {(1.0, EVERY_FRAME)}
    assert len(ticks(drawn)) >= 0.89 * 20e6 / PERIOD_US
    of.fixed_us, of.pixels_us = 20e3, 18e3
    of.play(2)
    assert {each.scale for each in of.play(20)} == {0.5}, "much is gained, as often as not all are in time"


def test_pixels_come_back_once_all_frames_are_in_time_with_them_where_fewer_gain_little() -> None:
    of = machine(28.0, 12.0)
    of.play(5)
    of.fixed_us, of.pixels_us = 23e3, 8e3
    of.play(10)
    assert {(each.scale, each.permille) for each in of.play(60)} == {(1.0, EVERY_FRAME)}
    gaining = machine(5.0, 54.0)
    gaining.play(5)
    gaining.fixed_us, gaining.pixels_us = 1e3, 30e3
    assert {each.scale for each in gaining.play(60)[60:]} == {0.5}, "not for so little room"


@pytest.mark.parametrize("full_ms", [40.0, 60.0, 100.0])
def test_a_client_that_always_wants_all_pixels_leaves_frames_out(full_ms: float) -> None:
    of = machine(0.0, full_ms, made(SCALES[FULL]))
    of.play(3)
    drawn = of.play(20)
    assert {each.scale for each in drawn} == {1.0}
    assert len(ticks(drawn)) >= 0.9 * 20e3 / full_ms, "the machine does not rest"


def test_pictures_between_come_last_and_only_where_all_of_them_fit() -> None:
    quick, middling = machine(1.0, 9.0, made(between=AUTO)), machine(2.0, 18.0, made(between=AUTO))
    assert {each.step_us for each in quick.play(10)[60:]} == {1e6 / 60}
    assert {each.step_us for each in middling.play(10)} == {None}
    assert {each.scale for each in middling.drawn} == {1.0}


def test_a_display_that_is_much_faster_gets_as_many_as_fit_evenly() -> None:
    of = machine(1.0, 9.0, made(between=AUTO, rate=120.0))
    drawn = of.play(10)[60:]
    assert {each.step_us for each in drawn} == {2e6 / 120}
    assert sum(not each.media for each in drawn) == pytest.approx(sum(each.media for each in drawn), abs=1)


@pytest.mark.parametrize(("rate", "between"), [(30.0, AUTO), (33.0, ON), (60.0, OFF)])
def test_none_come_on_a_display_of_media_frames_alone_or_where_nobody_wants_them(rate: float, between: str) -> None:
    assert made(between=between, rate=rate).step_us is None
    assert {each.step_us for each in machine(0.5, 0.5, made(between=between, rate=rate)).play(5)} == {None}


def test_pictures_that_are_wished_for_in_any_case_cost_pixels() -> None:
    quality = made(between=ON)
    of = machine(1.0, 25.0, quality)
    assert quality.fits(0, 1.0)
    of.play(3)
    assert {(each.scale, each.step_us) for each in of.play(10)} == {(0.5, 1e6 / 60)}


def test_a_client_that_leaves_none_out_displays_every_frame() -> None:
    of = machine(60.0, 10.0, made(skips=False))
    assert {each.permille for each in of.play(10)} == {EVERY_FRAME}


# ---------------------------------------------------------------------------------------------------------- in time


def test_it_begins_with_the_whole_and_halves_what_takes_too_long_soon() -> None:
    drawn = machine(5.0, 54.0).play(5)
    first = next(each for each in drawn if each.scale < 1)
    assert first.done_us <= 3 * DOWN_AFTER_US


@pytest.mark.parametrize("hitch_ms", [60.0, 400.0, 5_000.0])
def test_one_hitch_changes_nothing(hitch_ms: float) -> None:
    quality, now_us = made(), 0
    for number in range(300):
        took_us = 1e3 * (hitch_ms if number in {0, 150} else 15.0)
        now_us += round(max(took_us, PERIOD_US))
        quality.observe(now_us, took_us, took_us / 2)
        assert (quality.scale, quality.permille) == (1.0, EVERY_FRAME)


def test_a_machine_that_becomes_free_is_used_again_and_not_before_a_while() -> None:
    of = machine(5.0, 54.0)
    of.play(5)
    of.pixels_us = 15e3
    drawn = of.play(10)
    back = next(each for each in drawn if each.scale == 1.0)
    assert UP_AFTER_US <= back.done_us - 5e6 <= 2 * UP_AFTER_US
    assert {each.scale for each in of.play(10)} == {1.0}


def test_after_a_long_load_every_frame_is_displayed_again() -> None:
    of = machine(2.0, 15.0, load=lambda now_us: 8.0 if now_us < 6e6 else 1.0)
    of.play(6)
    assert of.quality.permille < 800
    of.play(8)
    assert (of.quality.scale, of.quality.permille) == (1.0, EVERY_FRAME)


def test_it_displays_a_quarter_at_least() -> None:
    of = machine(400.0, 0.0)
    of.play(30)
    assert of.quality.permille == LEAST_PERMILLE


def test_a_share_falls_by_half_at_most_at_once() -> None:
    shares = [each.permille for each in machine(300.0, 0.0).play(10)]
    assert shares[-1] < 300
    assert all(b >= a // 2 for a, b in pairwise(shares))


@pytest.mark.parametrize("full_ms", [24.0, 26.0, 28.0, 29.0, 31.0, 40.0])
@pytest.mark.parametrize("half", [0.3, 0.4, 0.6])
def test_it_does_not_flicker_at_the_edge(full_ms: float, half: float) -> None:
    """A machine of which half the pixels do not save what they are thought to: the whole is tried ever more seldom."""
    drawn = machine(5.0, full_ms, pixels_at=lambda scale: 1.0 if scale == 1.0 else half).play(60)
    assert len(changes(drawn)) <= 12
    assert sum(at > 30e6 for at in changes(drawn)) <= 4


# ---------------------------------------------------------------------------------------------------- viewers' wishes


def test_a_wish_is_followed_and_what_was_measured_stays() -> None:
    quality = made()
    machine(5.0, 54.0, quality).play(3)
    assert quality.scale == 0.5
    for wish, scale in ((FULL, 1.0), (HALF, 0.5), (AUTO, 1.0)):
        quality.wish(SCALES[wish], OFF)
        assert quality.scale == scale
    quality.observe(10_000_000, 59e3, 54e3)
    quality.observe(10_000_000 + DOWN_AFTER_US, 59e3, 54e3)
    assert quality.scale == 0.5


def test_a_wish_that_is_repeated_changes_nothing() -> None:
    of = machine(5.0, 54.0)
    of.play(3)
    of.quality.wish(list(SCALES[AUTO]), OFF)
    assert of.quality.scale == 0.5


def test_a_restart_begins_the_while_anew() -> None:
    quality = made()
    quality.observe(0, 60e3, 50e3)
    for now_us in range(100_000, 2_000_000, 100_000):
        quality.restart()
        quality.observe(now_us, 60e3, 50e3)
    assert quality.scale == 1.0
    quality.observe(2_000_000 + DOWN_AFTER_US, 60e3, 50e3)
    assert quality.scale == 0.5


def test_at_double_speed_there_is_half_the_time() -> None:
    quality = made()
    quality.period_us = PERIOD_US / 2
    of = machine(5.0, 20.0, quality)
    of.play(5)
    assert quality.scale == 0.5


def test_a_slower_display_than_before_has_fewer_pictures_between() -> None:
    of = machine(0.5, 2.0, made(between=AUTO, rate=120.0))
    of.play(5)
    assert of.quality.step_us == 1e6 / 120
    of.quality.display_us = 1e6 / 30
    of.play(0.1)
    assert of.quality.step_us is None


# ------------------------------------------------------------------------------------------------------------- ticks


def test_the_last_tick_is_displayed_in_any_case() -> None:
    assert [next_due(tick, 31, 250) for tick in (27, 28, 29, 30)] == [28, 28, 30, 30]


def test_the_newest_due_is_one_that_is_displayed() -> None:
    assert newest_due(4, 10**9, 500, lambda tick: tick <= 9) == 8
    assert newest_due(4, 10**9, 500, lambda tick: False) == 4
    assert newest_due(28, 31, 250, lambda tick: True) == 30


# -------------------------------------------------------------------------------------------------------- properties

LADDERS = st.sampled_from([SCALES[FULL], SCALES[HALF], SCALES[AUTO], PAGE])
BETWEEN = st.sampled_from([OFF, ON, AUTO])
RATES = st.sampled_from([30.0, 60.0, 90.0, 120.0])
COSTS = st.floats(0.1, 120.0)


def spends(quality: Quality) -> float:
    """Share of the time that is thought to be spent on what is chosen."""
    return quality._takes_us(quality._level) / quality.period_us * quality.permille / EVERY_FRAME


@given(
    LADDERS,
    BETWEEN,
    RATES,
    st.lists(st.tuples(st.integers(0, 800), COSTS, st.floats(0, 1), st.booleans()), min_size=1, max_size=200),
)
def test_whatever_is_observed_a_dearer_setting_is_one_that_fits(
    scales: tuple[float, ...], between: str, rate: float, pictures: list[tuple[int, float, float, bool]]
) -> None:
    quality, now_us = made(scales, between, rate), 0
    for step_ms, took_ms, share, media in pictures:
        before = quality.scale, quality.permille, quality._level
        now_us += step_ms * 1000
        quality.observe(now_us, took_ms * 1e3, took_ms * 1e3 * share, media=media or quality.step_us is None)
        after = quality.scale, quality.permille, quality._level
        assert after[0] in scales
        assert LEAST_PERMILLE <= after[1] <= EVERY_FRAME
        assert abs(after[2] - before[2]) + (after[1] != before[1]) <= 1, "one thing at a time"
        if after[2] > before[2]:
            assert after[1] == EVERY_FRAME, "every frame first"
            assert spends(quality) <= UP_SHARE
        elif after[1] > before[1]:
            assert spends(quality) <= HEADROOM


@settings(max_examples=60, deadline=None)
@example((1.0,), OFF, 30.0, 38.0, 120.0, 0)  # stayed just above the least share, which is more than it can do
@given(LADDERS, BETWEEN, RATES, st.floats(0.1, 60.0), st.floats(0.1, 120.0), st.integers(0, 9))
def test_on_a_machine_of_constant_speed_it_settles_on_what_fits(
    scales: tuple[float, ...], between: str, rate: float, fixed_ms: float, pixels_ms: float, seed: int
) -> None:
    of = machine(fixed_ms, pixels_ms, made(scales, between, rate), noise=0.05, seed=seed)
    of.play(40)
    drawn = of.play(20)
    assert len({each[3:] for each in drawn}) <= 2, "but for one more try"
    quality = of.quality
    lowest = quality.permille == LEAST_PERMILLE
    assert spends(quality) <= 1.2 or lowest
    if spends(quality) < 0.6 and quality.permille < EVERY_FRAME:
        pytest.fail("the machine rests while frames are left out")


@settings(max_examples=60, deadline=None)
@given(
    LADDERS,
    BETWEEN,
    st.floats(0.5, 30.0),
    st.floats(0.5, 60.0),
    st.floats(0.3, 8.0),
    st.floats(1.0, 6.0),
    st.integers(0, 9),
)
def test_it_changes_no_more_often_than_its_patience_allows(
    scales: tuple[float, ...], between: str, fixed_ms: float, pixels_ms: float, every_s: float, times: float, seed: int
) -> None:
    """Under a load that comes and goes: no step up sooner than the least patience after a step down."""
    of = machine(
        fixed_ms,
        pixels_ms,
        made(scales, between),
        noise=0.2,
        seed=seed,
        load=lambda now_us: times if int(now_us / 1e6 / every_s) % 2 else 1.0,
    )
    drawn = of.play(60)
    place = {scale: number for number, scale in enumerate(scales)}
    steps = [
        (
            b.done_us,
            (place[b.scale], b.permille, -(b.step_us or 1e9)) > (place[a.scale], a.permille, -(a.step_us or 1e9)),
        )
        for a, b in pairwise(drawn)
        if a[3:] != b[3:]
    ]
    last_down_us = None
    for at_us, up in steps:
        if up and last_down_us is not None:
            longest_us = max(b.done_us - a.done_us for a, b in pairwise(drawn))
            assert at_us - last_down_us >= UP_AFTER_US - longest_us
        last_down_us = last_down_us if up else at_us
    assert len(steps) <= 2 * 60e6 / UP_AFTER_US + 8


@settings(max_examples=40, deadline=None)
@given(
    LADDERS, st.floats(0.5, 8.0), st.floats(0.5, 15.0), st.floats(2.0, 20.0), st.floats(0.5, 12.0), st.integers(0, 9)
)
def test_after_a_load_has_ended_everything_is_as_before(
    scales: tuple[float, ...], fixed_ms: float, pixels_ms: float, times: float, seconds: float, seed: int
) -> None:
    load_ends_us = 5e6 + seconds * 1e6
    of = machine(
        fixed_ms,
        pixels_ms,
        made(scales),
        noise=0.1,
        seed=seed,
        load=lambda now_us: times if 5e6 <= now_us < load_ends_us else 1.0,
    )
    of.play(5)
    assert (of.quality.scale, of.quality.permille) == (scales[-1], EVERY_FRAME)
    of.play(seconds + UP_AFTER_MOST_US / 1e6 + 10)
    assert (of.quality.scale, of.quality.permille) == (scales[-1], EVERY_FRAME)
