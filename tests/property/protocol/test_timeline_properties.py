"""Any timeline: ticks and times lead to each other, and a new anchor displays what the old one did."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from cags_protocol.timeline import Timeline
from cags_protocol.wire.messages import Control

TICKS = st.integers(-(10**4), 10**6)


@st.composite
def timelines(draw: st.DrawFn) -> Timeline:
    frames = draw(st.integers(1, 10**5))
    return Timeline(
        draw(st.floats(1e-2, 1000.0)),
        frames,
        draw(st.integers(0, frames - 1)),
        draw(st.integers(0, 2**52)),
        draw(st.floats(0.01, 16.0)),
        draw(st.booleans()),
        draw(st.booleans()),
    )


@given(timelines(), TICKS)
def test_a_tick_is_the_first_from_its_own_time_on_and_the_next_from_a_microsecond_later(
    made: Timeline, tick: int
) -> None:
    at_us = made.display_us(tick)
    assert made.first_tick(at_us) == tick
    assert made.first_tick(at_us + 1) == tick + 1


@given(timelines(), TICKS)
def test_ticks_are_a_period_apart_to_the_microsecond(made: Timeline, tick: int) -> None:
    assert abs(made.display_us(tick + 1) - made.display_us(tick) - made.period_us) <= 1.5


@given(timelines(), st.integers(0, 10**6))
def test_frames_follow_each_other_and_end_with_their_round(made: Timeline, tick: int) -> None:
    end = made.round_end(tick)
    if not made.playing:
        assert made.media_frame(tick) == made.frame
    elif tick < end:
        assert made.media_frame(end - 1) == made.frames - 1
        assert made.media_frame(tick) == made.frames - (end - tick)
        assert made.media_frame(end) == (0 if made.loop else None)
    else:
        assert made.media_frame(tick) is None
        assert not made.loop


@given(timelines(), st.integers(0, 10**4), st.integers(0, 10**4))
def test_going_on_from_a_later_tick_displays_the_same(made: Timeline, tick: int, further: int) -> None:
    made = replace(made, playing=True)
    frame = made.media_frame(tick)
    if frame is None:
        return
    moved = made.controlled(Control("play", frame, made.display_us(tick), made.rate, made.loop))
    assert moved.media_frame(further) == made.media_frame(tick + further)
    assert abs(moved.display_us(further) - made.display_us(tick + further)) <= 1
