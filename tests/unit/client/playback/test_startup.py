"""How long the first frame is held."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from cags_client.playback.startup import PREVIEW_EVERY_US, QUIET_US, UNREFINED_QUIET_US, Startup

MOST_US = 700_000


def test_before_the_first_frame_is_there_nothing_ends() -> None:
    startup = Startup(MOST_US, 0)
    startup.came(10)
    assert startup.ends_us is None


def test_only_the_first_frame_that_is_whole_is_held() -> None:
    startup = Startup(MOST_US, 0)
    assert startup.whole(100_000)
    ends_us = startup.ends_us
    assert not startup.whole(200_000)
    assert startup.ends_us == ends_us


@given(st.lists(st.integers(1, 300_000), max_size=12))
def test_it_ends_when_nothing_more_comes_or_after_the_longest_wait(gaps_us: list[int]) -> None:
    startup, now_us = Startup(MOST_US, 0), 50_000
    startup.came(now_us)
    startup.whole(now_us)
    quiet = None
    for gap_us in gaps_us:
        if quiet is None and gap_us > QUIET_US:
            quiet = now_us + QUIET_US
        now_us += gap_us
        if quiet is None:
            startup.came(now_us)
    assert startup.ends_us == min(50_000 + MOST_US, quiet if quiet is not None else now_us + QUIET_US)


def test_without_any_time_to_hold_it_ends_at_once() -> None:
    startup = Startup(0, 0)
    startup.whole(5_000)
    assert startup.ends_us == 5_000


def test_what_is_held_is_drawn_now_and_then() -> None:
    startup = Startup(MOST_US, 0)
    drawn = [now_us for now_us in range(0, 500_000, 10_000) if startup.preview(now_us)]
    assert drawn == list(range(PREVIEW_EVERY_US, 500_000, PREVIEW_EVERY_US))


def test_the_longest_hold_begins_once_anything_can_be_refined() -> None:
    startup = Startup(MOST_US, 0)
    startup.whole(100_000)
    for now_us in range(100_000, 100_000 + 2 * MOST_US, 20_000):  # codebooks over a thin link
        startup.came(now_us, equipped=False)
        assert startup.ends_us is None
    equipped_us = now_us
    for now_us in range(equipped_us, equipped_us + 2 * MOST_US, 20_000):
        startup.came(now_us)
    assert startup.ends_us == equipped_us + MOST_US


def test_what_comes_between_codebooks_and_tiles_does_not_end_the_hold() -> None:
    """References that waited behind the codebooks of a slow link took more than a quarter of a second there."""
    startup = Startup(2 * UNREFINED_QUIET_US, 0)
    startup.whole(100_000)
    startup.came(500_000, equipped=False)
    startup.came(600_000, tile=False)  # the codebooks
    assert startup.ends_us == 600_000 + UNREFINED_QUIET_US
    startup.came(700_000, tile=False)  # a part of a reference, which counted as what ends the longer wait
    assert startup.ends_us == 700_000 + UNREFINED_QUIET_US
    startup.came(900_000)  # the first tile that needs them
    assert startup.ends_us == 900_000 + QUIET_US
    startup.came(950_000, tile=False)
    assert startup.ends_us == 950_000 + QUIET_US
