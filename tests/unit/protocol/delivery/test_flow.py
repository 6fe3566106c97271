import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_common.errors import ProtocolError
from cags_protocol.delivery.flow import (
    LEAST_PACKET_BYTES,
    MAX_PACING_US,
    PACING_GAIN,
    PACKET_US,
    REORDER_PACKETS,
    FlowControl,
)
from cags_protocol.delivery.round_trips import MIN_RTT_WINDOW_US
from cags_protocol.delivery.send_queue import Entry
from cags_protocol.events import Stance
from cags_protocol.wire.limits import PACKET_BYTES
from cags_protocol.wire.messages import SeqRange
from support.wire_pair import tile

BACK_US = 400
"""What acknowledgements travel."""

ENTRY = Entry(1, tile(0, 0, 10), (1, 0, 1), b"head", memoryview(b"body"))


def flow(rate_bps=8e6, window_us=40_000):
    return FlowControl(window_us, rate_bps, 0)


def send(control, now_us, size=1000):
    control.on_sent(ENTRY, size, now_us)
    return control.next_seq - 1


def ack(control, ranges, now_us, *, delay_us=0, late_us=0, offset_us=0):
    """An acknowledgement that waited at the client and, ``late_us``, until the server read it."""
    received_us = now_us - late_us - delay_us - BACK_US + offset_us
    return control.on_ack(ranges, received_us, delay_us, now_us)


def test_credit_is_rate_times_window_and_round_trip():
    control = flow()
    assert control.window_bytes == 40_000
    send(control, 0)
    ack(control, [SeqRange(1, 1)], 60_000)
    assert control.round_trips.shortest_us == 60_000
    assert control.window_bytes == 100_000


def test_a_queue_that_others_hold_up_counts_as_the_links_own():
    control, now_us = flow(rate_bps=8e6), 0
    for step in range(300):
        now_us += 10_000
        seq = send(control, now_us)
        ack(control, [SeqRange(seq, seq)], now_us + (50_000 if step == 0 else 250_000))
        now_us += 250_000 if step else 50_000
        if control.stance is Stance.COMPETE:
            break
    assert control.window_bytes == pytest.approx(40_000 + 250_000 + PACKET_BYTES, rel=0.3)
    assert control.round_trips.shortest_us == 50_000


def test_on_a_slow_link_the_queue_is_its_own():
    """A packet of the largest size, sent while the link was thought faster, takes a quarter of a second."""
    control, now_us = flow(rate_bps=250e3, window_us=20_000), 0
    for step in range(60):
        seq = send(control, now_us, 8192)
        now_us += 50_000 if step == 0 else 400_000
        ack(control, [SeqRange(seq, seq)], now_us)
        assert control.stance is Stance.GIVE_WAY


@given(st.floats(1.0, 1e9))
def test_a_packet_is_as_large_as_the_link_carries_in_its_time_within_bounds(rate_bps):
    size = flow(rate_bps=rate_bps).packet_bytes
    assert LEAST_PACKET_BYTES <= size <= PACKET_BYTES
    assert size <= max(rate_bps * PACKET_US / 8e6, LEAST_PACKET_BYTES)
    assert size >= min(rate_bps * PACKET_US / 8e6 - 1, PACKET_BYTES)


def test_credit_never_falls_below_two_packets():
    assert flow(rate_bps=1.0).window_bytes == 2 * LEAST_PACKET_BYTES
    assert flow(rate_bps=4e6, window_us=1000).window_bytes == 2 * PACKET_BYTES


@pytest.mark.parametrize("rate_bps", [1.0, 1e6, 4e6])
def test_credit_is_used_up_and_comes_back(rate_bps):
    control = flow(rate_bps=rate_bps, window_us=1000)
    size = control.packet_bytes
    assert control.has_credit()
    send(control, 0, size)
    send(control, 0, size)
    assert not control.has_credit()
    for _ in range(2):
        assert control.has_credit(reserve=True)
        send(control, 0, size)
    assert not control.has_credit(reserve=True)
    ack(control, [SeqRange(1, 3)], 1000)
    assert control.has_credit()


def test_packets_are_paced_somewhat_faster_than_the_link():
    control = flow(rate_bps=8e6)
    now_us, sent = 1_000_000, 0
    while now_us < 2_000_000:
        now_us = max(now_us, control.paced_until_us)
        send(control, now_us)
        sent += 1000
    assert sent == pytest.approx(PACING_GAIN * 1e6, rel=0.05)


def test_an_empty_link_is_not_waited_for_however_low_the_estimate():
    control = flow(rate_bps=1000.0)
    send(control, 0, 8192)
    assert control.paced_until_us > 20_000
    ack(control, [SeqRange(1, 1)], 20_000)
    assert control.paced_until_us <= 20_000


def test_the_pace_follows_the_estimate():
    control = flow(rate_bps=8e5)
    send(control, 0, 8192)
    slow_us = control.paced_until_us
    control.rate_bps = 8e6
    assert control.paced_until_us < slow_us


@given(st.floats(1.0, 1e9), st.lists(st.tuples(st.integers(0, 1_000_000), st.integers(1, 8192)), min_size=1))
def test_no_packet_waits_for_longer_than_it_may(rate_bps, packets):
    control, now_us = flow(rate_bps=rate_bps), 0
    for pause_us, size in packets:
        now_us += pause_us
        send(control, now_us, size)
        assert control.paced_until_us <= now_us + MAX_PACING_US


def test_time_in_which_nothing_left_is_made_up_for_up_to_the_window():
    control = flow(rate_bps=8e6, window_us=20_000)
    send(control, 0)
    burst = 0
    while control.paced_until_us <= 5_000_000:
        send(control, 5_000_000)
        burst += 1000
    assert burst == pytest.approx(PACING_GAIN * 20_000, abs=1500)


def test_the_round_trip_leaves_out_the_wait_for_the_acknowledgement():
    control = flow()
    send(control, 1000)
    ack(control, [SeqRange(1, 1)], 26_000, delay_us=5000)
    assert control.round_trips.newest_us == 20_000


def test_the_shortest_round_trip_is_forgotten_in_time():
    control = flow()
    for start_us, rtt_us in ((0, 10_000), (1_000_000, 50_000), (MIN_RTT_WINDOW_US + 500_000, 70_000)):
        seq = send(control, start_us)
        ack(control, [SeqRange(seq, seq)], start_us + rtt_us)
    assert control.round_trips.shortest_us == 50_000


def test_the_rate_of_a_burst_counts_its_whole_round_trip():
    control = flow(rate_bps=1e9)
    for _ in range(50):
        send(control, 0, 1250)  # a burst of 50 x 10 kbit
    rates = [ack(control, [SeqRange(seq, seq)], 20_000 + 1000 * seq).delivery_rate_bps for seq in range(1, 51)]
    assert rates[-1] == pytest.approx(50 * 10_000 / 0.070, rel=0.01)


def test_an_idle_server_marks_what_follows():
    control = flow()
    control.on_idle()
    send(control, 0)
    assert ack(control, [SeqRange(1, 1)], 1000).app_limited
    send(control, 2000)
    send(control, 2000)
    ack(control, [SeqRange(2, 2)], 3000)
    send(control, 3000)
    assert not ack(control, [SeqRange(4, 4)], 4000).app_limited


def test_gaps_become_losses_only_long_after():
    control = flow(rate_bps=1e9)
    for _ in range(REORDER_PACKETS + 2):
        send(control, 0)
    assert ack(control, [SeqRange(2, REORDER_PACKETS + 1)], 1000).lost == []
    result = ack(control, [SeqRange(REORDER_PACKETS + 2, REORDER_PACKETS + 2)], 1000)
    assert [seq for seq, _ in result.lost] == [1]
    assert control.in_flight_bytes == 0
    assert control.lost_bytes == 1000


def test_repeated_acknowledgements_say_nothing():
    control = flow()
    send(control, 0)
    assert ack(control, [SeqRange(1, 1)], 1000) is not None
    assert ack(control, [SeqRange(1, 1)], 2000) is None
    assert ack(control, [], 2000) is None
    assert control.delivered_bytes == 1000


def test_what_was_never_sent_cannot_be_acknowledged():
    control = flow()
    with pytest.raises(ProtocolError, match="ack of packet 1, but only 0 were sent"):
        ack(control, [SeqRange(1, 1)], 1000)


def round_trips(control, times_us):
    for number, rtt_us in enumerate(times_us):
        seq = send(control, number * 1000)
        ack(control, [SeqRange(seq, seq)], number * 1000 + rtt_us)
    return control.window_bytes


def test_jitter_widens_the_window_and_a_growing_queue_does_not():
    calm = round_trips(flow(), [20_000] * 100)
    assert round_trips(flow(), [20_000 + 1000 * n for n in range(100)]) == calm
    assert round_trips(flow(), [20_000, 40_000] * 50) > 1.5 * calm


def test_a_rate_is_over_the_longer_of_sending_and_acknowledging():
    """Acknowledgements that come in a bunch do not say that the link carried it all at once."""
    control = flow()
    send(control, 0)
    send(control, 1_000)
    ack(control, [SeqRange(1, 1)], 50_000)
    send(control, 51_000)
    bunch = ack(control, [SeqRange(1, 3)], 52_000)
    assert bunch.delivery_rate_bps == pytest.approx(2_000 * 8e6 / 51_000), "not 2,000 bytes in 2 ms"
    send(control, 60_000)
    assert ack(control, [SeqRange(4, 4)], 70_000).delivery_rate_bps == pytest.approx(1_000 * 8e6 / 10_000)


def rates_of(late_us, *, offset_us=0, packets=40):
    """Rate samples and round trips of packets that go out and arrive 10 ms apart, read so much late by turns."""
    control = flow(rate_bps=1e9)
    results = []
    for number in range(packets):
        send(control, 10_000 * number, 1250)  # 1 Mbps
        if number >= 2:
            late = late_us[number % len(late_us)]
            seq, now_us = number - 1, 10_000 * (number - 2) + 20_000 + late
            result = ack(control, [SeqRange(seq, seq)], now_us, late_us=late, offset_us=offset_us)
            results.append((result.delivery_rate_bps, control.round_trips.newest_us))
    return control, results


@pytest.mark.parametrize("offset_us", [0, -3_600_000_000, 86_400_000_000])
def test_acknowledgements_that_are_read_late_are_no_queue_and_no_slow_link(offset_us):
    control, results = rates_of([0, 3_000, 9_000], offset_us=offset_us)
    assert set(results[3:]) == {(1e6, 20_000)}
    assert control.window_bytes > rates_of([0])[0].window_bytes, "the window lasts until the server looks again"


def test_a_client_whose_clock_is_set_tells_no_more_than_the_acknowledgements_time():
    control = flow()
    for number, offset_us in enumerate([0, 0, 5_000_000, -5_000_000]):
        seq = send(control, 100_000 * number)
        ack(control, [SeqRange(seq, seq)], 100_000 * number + 30_000, offset_us=offset_us)
        assert control.round_trips.newest_us == 30_000
