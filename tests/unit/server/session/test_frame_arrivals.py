"""Frames in time, late ones and stalls, as the operator's page counts them."""

from __future__ import annotations

import pytest

from cags_protocol.timeline import Timeline
from cags_server.records import StreamStats
from cags_server.session.clock import ClientClock
from cags_server.session.frame_arrivals import MOST_AT_ONCE, FrameArrivals

FPS, FRAMES = 10.0, 12
PERIOD_US, OFFSET_US = 100_000, 5_000_000
PLAYING = Timeline(FPS, FRAMES, playing=True)


def clock() -> ClientClock:
    """The client's, so much behind the server's."""
    known = ClientClock()
    known.observe(0, OFFSET_US)
    return known


def made() -> tuple[StreamStats, FrameArrivals]:
    """Figures, and what counts in them, of a clip that is one group of frames."""
    stats = StreamStats()
    return stats, FrameArrivals(stats, clock(), lambda frame: 0)


def bring(arrivals: FrameArrivals, frames: range, at_us: int = 0) -> None:
    """The ends of ``frames`` are sent, and arrive."""
    for frame in frames:
        arrivals.sent(frame)
        arrivals.arrived(frame, OFFSET_US + at_us)


def counts(stats: StreamStats) -> tuple[int, int, int]:
    return stats.frames_in_time, stats.frames_late, stats.stalls


@pytest.mark.parametrize(
    ("late_us", "expected"),
    [
        ([], (0, 0, 0)),
        ([-1, 0, -5], (3, 0, 0)),
        ([-1, 1, 7, 9, -1], (2, 3, 1)),
        ([1, -1, 1, -1, 1], (2, 3, 3)),
        ([-1, None, -1], (2, 1, 1)),
    ],
)
def test_a_run_of_late_frames_is_one_stall(late_us: list[int | None], expected: tuple[int, int, int]) -> None:
    """None: the end of the frame has not come yet."""
    stats, arrivals = made()
    for frame, late in enumerate(late_us):
        arrivals.sent(frame)
        if late is not None:
            arrivals.arrived(frame, OFFSET_US + frame * PERIOD_US + late)
        arrivals.displayed(PLAYING, frame * PERIOD_US, 1000)
    assert counts(stats) == expected


def test_frames_of_the_reserve_count_once_they_are_displayed() -> None:
    """Frames once counted at their arrival: of 9 displayed ones 14 were said to be in time."""
    stats, arrivals = made()
    bring(arrivals, range(8))
    arrivals.displayed(PLAYING, -1, 1000)
    assert counts(stats) == (0, 0, 0)
    arrivals.displayed(PLAYING, 2 * PERIOD_US, 1000)
    arrivals.displayed(PLAYING, 3 * PERIOD_US - 1, 1000)
    assert counts(stats) == (3, 0, 0)


def test_what_came_while_the_first_frame_was_held_counts_when_the_play_begins() -> None:
    """A control once made the frames forgotten that were held or on their way: 4 of 12 displayed ones counted."""
    stats, arrivals = made()
    bring(arrivals, range(5))
    arrivals.sent(5)
    arrivals.displayed(Timeline(FPS, FRAMES), 10 * PERIOD_US, 1000)  # paused
    arrivals.restart()
    arrivals.arrived(5, OFFSET_US)
    arrivals.displayed(PLAYING, 6 * PERIOD_US, 1000)
    assert counts(stats) == (6, 1, 1)


def test_what_the_client_discards_is_neither_held_nor_on_its_way() -> None:
    stats, arrivals = made()
    bring(arrivals, range(3))
    arrivals.sent(3)
    arrivals.forget()
    arrivals.arrived(3, OFFSET_US)
    arrivals.displayed(PLAYING, 3 * PERIOD_US, 1000)
    assert counts(stats) == (0, 4, 1)


def test_a_round_that_repeats_shows_what_the_client_holds() -> None:
    stats, arrivals = made()
    bring(arrivals, range(FRAMES))
    looping = Timeline(FPS, FRAMES, playing=True, loop=True)
    for tick in range(3 * FRAMES):
        arrivals.displayed(looping, tick * PERIOD_US, 1000)
    assert counts(stats) == (3 * FRAMES, 0, 0)


@pytest.mark.parametrize(("permille", "shown"), [(1000, 12), (500, 7), (250, 4)])
def test_frames_that_the_client_does_not_display_count_as_nothing_but_the_last_always_is(
    permille: int, shown: int
) -> None:
    stats, arrivals = made()
    bring(arrivals, range(FRAMES))
    arrivals.displayed(PLAYING, 20 * PERIOD_US, permille)
    arrivals.displayed(PLAYING, 30 * PERIOD_US, permille)
    assert counts(stats) == (shown, 0, 0)


def test_a_clock_that_jumps_has_displayed_nothing_meanwhile() -> None:
    stats, arrivals = made()
    looping = Timeline(FPS, FRAMES, playing=True, loop=True)
    bring(arrivals, range(FRAMES))
    arrivals.displayed(looping, PERIOD_US, 1000)
    arrivals.displayed(looping, 10**15, 1000)
    assert counts(stats) == (2, 0, 0)
    arrivals.displayed(looping, 10**15 + 2 * PERIOD_US, 1000)
    assert counts(stats) == (4, 0, 0)
    assert MOST_AT_ONCE < 10**15 / PERIOD_US


def test_frames_of_a_group_that_was_left_are_not_remembered() -> None:
    stats = StreamStats()
    arrivals = FrameArrivals(stats, clock(), lambda frame: frame // 6 * 6)
    bring(arrivals, range(FRAMES))
    arrivals.displayed(PLAYING, 6 * PERIOD_US, 1000)
    assert counts(stats) == (7, 0, 0)
    assert sorted(arrivals._arrived) == list(range(6, FRAMES))
