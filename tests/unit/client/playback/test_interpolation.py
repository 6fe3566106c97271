"""Times between media frames."""

from __future__ import annotations

import pytest

from cags_client.playback.interpolation import Interpolation, Moment

FRAME_US = 40_000
"""Of a clip of 25 frames a second."""


def begun(mode: str = "on", rate: float = 100.0, frames: int = 1) -> Interpolation:
    between = Interpolation(mode, rate)
    between.begin(1_000_000, 1_000_000 + frames * FRAME_US, frames)
    return between


def taken(between: Interpolation, step_us: int = 1_000, until_us: int = FRAME_US) -> list[Moment]:
    out = []
    for now_us in range(1_000_000, 1_000_000 + until_us, step_us):
        if (moment := between.take(now_us)) is not None:
            out.append(moment)
    return out


def test_pictures_come_at_the_rate_of_the_display_up_to_the_next_media_frame() -> None:
    assert taken(begun()) == [Moment(1_010_000, 0.25), Moment(1_020_000, 0.5), Moment(1_030_000, 0.75)]
    assert taken(begun(rate=25.0)) == [], "a display that shows media frames alone"
    assert taken(begun(rate=26.0)) == [], "and one that hardly shows more"
    assert [m.share for m in taken(begun(rate=50.0, frames=2), until_us=2 * FRAME_US)] == [0.5, 1.0, 1.5]


def test_a_picture_that_was_due_long_ago_gives_way_to_the_newest() -> None:
    between = begun()
    assert between.next_us() == 1_010_000
    assert between.take(1_031_000) == Moment(1_030_000, 0.75)
    assert between.next_us() is None
    assert between.take(1_039_000) is None


def test_only_with_time_for_it_unless_it_is_wanted_anyway() -> None:
    for mode, count in (("auto", 1), ("on", 3), ("off", 0)):
        between = Interpolation(mode, 100.0)
        between.drawing(900_000)
        between.drawn(920_000)  # 20 ms a picture
        between.begin(1_000_000, 1_000_000 + FRAME_US, 1)
        assert len(taken(between)) == count, mode


def test_what_pictures_take_is_learnt_and_a_hitch_forgotten() -> None:
    between = begun("auto")
    for took_us in (30_000, *[2_000] * 20):
        between.drawing(0)
        between.drawn(took_us)
    assert len(taken(between)) == 3
    between.drawn(9_999_999)  # nothing was begun
    assert between._takes_us == pytest.approx(2_000, rel=0.2)


def test_nothing_follows_where_the_next_frame_is_not_known() -> None:
    between = begun()
    between.cancel()
    assert between.next_us() is None
    assert between.take(1_020_000) is None
