"""Round trips without the server's own delay, the shortest of late, and jitter."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from cags_protocol.delivery.round_trips import MAX_JITTER_US, MIN_RTT_WINDOW_US, RoundTrips


def test_the_shortest_is_forgotten_after_a_while() -> None:
    trips = RoundTrips()
    assert trips.shortest_us == 0
    trips.note(0, 10_000, 5_000)
    trips.note(1, 30_000, 25_000)
    assert trips.shortest_us == 10_000
    trips.note(MIN_RTT_WINDOW_US + 1, 40_000, 35_000)
    assert trips.shortest_us == 30_000


def test_a_queue_that_grows_is_no_jitter_and_jumps_are() -> None:
    growing, jumping = RoundTrips(), RoundTrips()
    for number in range(100):
        for trips, late_us in ((growing, 1_000 * number), (jumping, 20_000 if number % 2 else 0)):
            trips.note(number, 10_000 + late_us, 5_000 + late_us)
    assert growing.jitter_us == growing.jitter_as_read_us == 0
    assert 40_000 < jumping.jitter_us <= MAX_JITTER_US
    assert jumping.jitter_as_read_us == jumping.jitter_us


def test_what_the_server_reads_late_is_jitter_of_reading_alone() -> None:
    trips = RoundTrips()
    for number in range(100):
        trips.note(number, 10_000 + (20_000 if number % 2 else 0), 5_000)
        assert trips.newest_us == 10_000
    assert trips.jitter_us == 0
    assert 40_000 < trips.jitter_as_read_us <= MAX_JITTER_US


@given(st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 10**6), st.integers(-(10**12), 10**12)), min_size=1))
def test_a_round_trip_lies_between_the_shortest_and_the_time_until_now(packets: list[tuple[int, int, int]]) -> None:
    """Whatever the client's clock says."""
    trips, now_us = RoundTrips(), 0
    for step_us, until_now_us, one_way_us in packets:
        now_us += step_us
        trips.note(now_us, until_now_us, one_way_us)
        assert trips.shortest_us <= trips.newest_us <= until_now_us
        assert 0 <= trips.jitter_us <= MAX_JITTER_US
