"""When attempts are made after a loss."""

from __future__ import annotations

import itertools
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_client.net.reconnect import JITTER, LASTING_US, MAX_DELAY_US, Reconnect

SECOND = 1_000_000


def attempts(reconnect: Reconnect, until_us: int) -> list[int]:
    """Times at which attempts are made, each of which fails at once."""
    times, now_us = [], 0
    while (timer_us := reconnect.next_timer_us()) is not None and timer_us <= until_us:
        now_us = max(now_us, timer_us)
        if reconnect.expired(now_us):
            break
        if reconnect.begin(now_us):
            times.append(now_us)
            reconnect.lost(now_us)
    return times


def test_the_first_attempt_is_made_at_once_and_the_others_ever_more_seldom() -> None:
    reconnect = Reconnect(10 * SECOND, random.Random(1))
    reconnect.restored(0)
    reconnect.lost(0)
    times = attempts(reconnect, 60 * SECOND)
    assert times[0] == 0
    assert times[-1] <= 10 * SECOND
    assert len([t for t in times if t < SECOND]) >= 4, "a short loss is noticed soon"
    assert 10 <= len(times) <= 25


@given(st.integers(0, 2**32), st.integers(1, 30))
def test_waits_are_bounded_and_patience_ends(seed: int, patience_s: int) -> None:
    reconnect = Reconnect(patience_s * SECOND, random.Random(seed))
    reconnect.restored(0)
    reconnect.lost(0)
    times = attempts(reconnect, 100 * SECOND)
    waits = [b - a for a, b in itertools.pairwise(times)]
    assert all(0 < wait <= MAX_DELAY_US for wait in waits)
    assert reconnect.expired(patience_s * SECOND)
    assert not reconnect.expired(patience_s * SECOND - 1)


def test_clients_do_not_come_back_in_step() -> None:
    several = []
    for seed in range(8):
        reconnect = Reconnect(10 * SECOND, random.Random(seed))
        reconnect.restored(0)
        reconnect.lost(0)
        several.append(tuple(attempts(reconnect, 5 * SECOND)))
    assert len({times[1:] for times in several}) == 8
    assert 0 < JITTER < 1


def test_an_attempt_is_under_way_until_it_is_answered() -> None:
    reconnect = Reconnect(SECOND, random.Random(0))
    assert not reconnect.away
    assert reconnect.next_timer_us() is None
    reconnect.restored(1)
    reconnect.lost(5)
    assert reconnect.begin(5)
    assert reconnect.trying
    assert not reconnect.begin(6)
    assert reconnect.next_timer_us() == 5 + SECOND, "patience ends meanwhile too"
    reconnect.restored(6)
    assert not reconnect.away
    assert reconnect.next_timer_us() is None


def test_a_server_that_lets_in_and_hangs_up_is_asked_ever_more_seldom() -> None:
    reconnect, now_us, times = Reconnect(10 * SECOND, random.Random(2)), 0, []
    reconnect.restored(now_us)
    reconnect.lost(now_us)
    while now_us < 20 * SECOND:
        timer_us = reconnect.next_timer_us()
        assert timer_us is not None
        now_us = max(now_us, timer_us)
        assert reconnect.begin(now_us)
        times.append(now_us)
        reconnect.restored(now_us)
        reconnect.lost(now_us + 1000)
    assert len([t for t in times if t >= 10 * SECOND]) <= 14, "about one a second in the end"
    reconnect.restored(now_us)
    reconnect.lost(now_us + LASTING_US)
    assert reconnect.begin(now_us + LASTING_US), "a session that lasted is taken up at once"


@pytest.mark.parametrize("patience_s", [0, 10])
def test_before_the_first_session_each_other_server_is_asked_once_and_at_once(patience_s: int) -> None:
    reconnect, asked = Reconnect(patience_s * SECOND, random.Random(3), others=2), 0
    while reconnect.possible:
        reconnect.lost(asked)
        assert reconnect.next_timer_us() == asked
        assert reconnect.begin(asked)
        asked += 1
        assert reconnect.next_timer_us() is None, "an attempt has its own time limit"
        assert not reconnect.expired(60 * SECOND)
    assert asked == 2
    reconnect.restored(asked)
    assert reconnect.possible == (patience_s > 0), "from the first session on it is patience that counts"
