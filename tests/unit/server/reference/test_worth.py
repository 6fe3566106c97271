"""Whether references are worth the processor where it is short."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from cags_server.reference.worth import IN_VAIN, LONG_FRAMES, LONGEST_REST_US, REST_US, SOON_FRAMES, Worth

LINK_BPS, PERIOD_US = 8e6, 40_000.0
FRAME_BYTES = round(LINK_BPS * PERIOD_US / 8e6)


def after(*frames: float, short: bool) -> Worth:
    worth = Worth()
    for _ in range(40):
        worth.made(slowly=short)
    assert worth.short is short
    for each in frames:
        worth.observe(round(each * FRAME_BYTES), LINK_BPS, PERIOD_US, 0)
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


def pays_at(worth: Worth, now_us: int) -> bool:
    worth.observe(round(2 * LONG_FRAMES * FRAME_BYTES), LINK_BPS, PERIOD_US, now_us)
    return worth.pays


def test_references_that_come_too_late_are_left_out_for_a_while_longer_each_time() -> None:
    worth, now_us, rests = Worth(), 0, []
    for _ in range(IN_VAIN - 1):
        worth.came(now_us, in_vain=True)
        assert pays_at(worth, now_us), "one that is late may be followed by one in time"
    for _ in range(6):
        worth.came(now_us, in_vain=True)
        began_us = now_us
        while not pays_at(worth, now_us):
            now_us += 100_000
        rests.append(now_us - began_us)
    assert rests == [min(REST_US << n, LONGEST_REST_US) for n in range(6)]


def test_one_reference_in_time_makes_all_good() -> None:
    worth = Worth()
    for in_vain in (True, True, False, True, True, False) + (True,) * IN_VAIN:
        assert pays_at(worth, 0)
        worth.came(0, in_vain=in_vain)
    assert not pays_at(worth, REST_US - 1)
    worth.came(REST_US, in_vain=False)
    assert pays_at(worth, REST_US)
    for _ in range(IN_VAIN):
        worth.came(REST_US, in_vain=True)
    assert not pays_at(worth, 2 * REST_US - 1) and pays_at(worth, 2 * REST_US), "the first rest again"
