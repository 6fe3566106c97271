"""Whether references are worth the processor where it is short."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from cags_server.reference.worth import LONG_FRAMES, SOON_FRAMES, Worth

LINK_BPS, PERIOD_US = 8e6, 40_000.0
FRAME_BYTES = round(LINK_BPS * PERIOD_US / 8e6)


def after(*frames: float) -> Worth:
    worth = Worth()
    for each in frames:
        worth.observe(round(each * FRAME_BYTES), LINK_BPS, PERIOD_US)
    return worth


@given(st.lists(st.floats(0, 200)))
def test_references_always_pay_where_there_is_time_for_them(frames: list[float]) -> None:
    assert after(*frames).pays(short=False)


def test_on_a_short_machine_they_pay_where_tiles_alone_would_take_long() -> None:
    assert not after(SOON_FRAMES / 2).pays(short=True)
    assert after(2 * LONG_FRAMES).pays(short=True)


def test_between_the_two_everything_stays() -> None:
    between = (SOON_FRAMES + LONG_FRAMES) / 2
    assert after(2 * LONG_FRAMES, between).pays(short=True)
    assert not after(SOON_FRAMES / 2, between).pays(short=True)


def test_before_anything_is_known_they_are_made() -> None:
    assert Worth().pays(short=True)
