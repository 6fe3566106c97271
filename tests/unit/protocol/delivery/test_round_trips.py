"""Shortest round trip and jitter."""

from __future__ import annotations

from cags_protocol.delivery.round_trips import MAX_JITTER_US, MIN_RTT_WINDOW_US, RoundTrips


def test_the_shortest_is_forgotten_after_a_while() -> None:
    trips = RoundTrips()
    assert trips.shortest_us == 0
    trips.note(0, 10_000)
    trips.note(1, 30_000)
    assert trips.shortest_us == 10_000
    trips.note(MIN_RTT_WINDOW_US + 1, 40_000)
    assert trips.shortest_us == 30_000


def test_a_queue_that_grows_is_no_jitter_and_jumps_are() -> None:
    growing, jumping = RoundTrips(), RoundTrips()
    for number in range(100):
        growing.note(number, 10_000 + 1_000 * number)
        jumping.note(number, 10_000 + (20_000 if number % 2 else 0))
    assert growing.jitter_us == 0
    assert 40_000 < jumping.jitter_us <= MAX_JITTER_US
