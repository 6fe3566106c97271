"""Times between media frames."""

from __future__ import annotations

from collections.abc import Callable

from cags_client.playback.interpolation import Interpolation, Moment

FRAME_US = 40_000
"""Of a clip of 25 frames a second."""


def always(now_us: int, due_us: float) -> bool:
    return True


def begun(rate: float = 100.0, frames: int = 1) -> Interpolation:
    between = Interpolation()
    between.begin(1_000_000, 1_000_000 + frames * FRAME_US, frames, 1e6 / rate)
    return between


def taken(
    between: Interpolation, until_us: int = FRAME_US, fits: Callable[[int, float], bool] = always
) -> list[Moment]:
    moments = (between.take(now_us, fits) for now_us in range(1_000_000, 1_000_000 + until_us, 1_000))
    return [moment for moment in moments if moment is not None]


def test_pictures_come_at_the_rate_of_the_display_up_to_the_next_media_frame() -> None:
    assert taken(begun()) == [Moment(1_010_000, 0.25), Moment(1_020_000, 0.5), Moment(1_030_000, 0.75)]
    assert taken(begun(rate=25.0)) == [], "a display that shows media frames alone"
    assert taken(begun(rate=26.0)) == [], "and one that hardly shows more"
    assert [m.share for m in taken(begun(rate=50.0, frames=2), until_us=2 * FRAME_US)] == [0.5, 1.0, 1.5]


def test_a_picture_that_was_due_long_ago_gives_way_to_the_newest() -> None:
    between = begun()
    assert between.next_us() == 1_010_000
    assert between.take(1_031_000, always) == Moment(1_030_000, 0.75)
    assert between.next_us() is None
    assert between.take(1_039_000, always) is None


def test_none_is_begun_that_would_make_the_next_media_frame_late() -> None:
    asked: list[float] = []

    def fits(now_us: int, due_us: float) -> bool:
        asked.append(due_us)
        return now_us + 20_000 <= due_us

    assert taken(begun(), fits=fits) == [Moment(1_010_000, 0.25), Moment(1_020_000, 0.5)]
    assert set(asked) == {1_000_000 + FRAME_US}


def test_nothing_follows_where_the_next_frame_is_not_known() -> None:
    between = begun()
    between.cancel()
    assert between.next_us() is None
    assert between.take(1_020_000, always) is None
