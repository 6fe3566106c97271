"""Whether references are worth the processor where it is short."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from cags_server.reference.worth import LONG_FRAMES, SOON_FRAMES, Worth

LINK_BPS, PERIOD_US = 8e6, 40_000.0
FRAME_BYTES = round(LINK_BPS * PERIOD_US / 8e6)


def after(*frames: float, short: bool) -> Worth:
    worth = Worth()
    for _ in range(40):
        worth.made(slowly=short)
    assert worth.short is short
    for each in frames:
        worth.observe(round(each * FRAME_BYTES), LINK_BPS, PERIOD_US)
    return worth


@given(st.lists(st.floats(0, 200)))
def test_references_always_pay_where_there_is_time_for_them(frames: list[float]) -> None:
    assert after(*frames, short=False).pays


def test_on_a_short_machine_they_pay_where_tiles_alone_would_take_long() -> None:
    assert not after(SOON_FRAMES / 2, short=True).pays
    assert after(2 * LONG_FRAMES, short=True).pays


def test_between_the_two_everything_stays() -> None:
    between = (SOON_FRAMES + LONG_FRAMES) / 2
    assert after(2 * LONG_FRAMES, between, short=True).pays
    assert not after(SOON_FRAMES / 2, between, short=True).pays


def test_before_anything_is_known_they_are_made() -> None:
    assert Worth().pays and after(short=True).pays
