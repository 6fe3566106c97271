"""The link against mahimahi's own loop, written out as its source does it, and conservation of bytes and order."""

from hypothesis import given
from hypothesis import strategies as st

from cags_shaper.link import Link, LinkSettings
from cags_shaper.trace import OPPORTUNITY_BYTES, trace_of_times
from support.mahimahi import MahimahiQueue

TIMES = st.lists(st.integers(0, 60), min_size=1, max_size=30).map(sorted).filter(lambda times: times[-1] > 0)
ARRIVALS = st.lists(st.tuples(st.integers(0, 30_000), st.integers(1, 1504)), max_size=60)
BOUND = st.none() | st.integers(1, 6000)


@given(TIMES, ARRIVALS, BOUND, st.none() | st.integers(1, 8))
def test_delivery_times_and_drops_are_mahimahis(times_ms, arrivals, queue_bytes, queue_packets):
    ours = Link(trace_of_times("t", times_ms), LinkSettings(queue_bytes=queue_bytes, queue_packets=queue_packets))
    theirs = MahimahiQueue(times_ms, queue_bytes, queue_packets)
    now_us, ours_out = 0, []
    for number, (gap_us, size) in enumerate(arrivals):
        now_us += gap_us
        while (t := ours.next_delivery_us()) is not None and t <= now_us:
            ours_out += [(t // 1000, data) for data in ours.pop_due(t)]
        assert ours.push(now_us, number, size) == theirs.push(now_us // 1000, number, size)
    while (t := ours.next_delivery_us()) is not None:
        ours_out += [(t // 1000, data) for data in ours.pop_due(t)]
    while theirs.waiting or theirs.left:
        theirs.rationalize(theirs.next_ms())
    assert ours_out == theirs.out


@given(
    TIMES,
    st.lists(st.tuples(st.integers(0, 30_000), st.integers(1, 20_000)), max_size=60),
    BOUND,
    st.integers(0, 50_000),
    st.integers(0, 20_000),
    st.floats(0, 0.9),
)
def test_bytes_and_order_are_conserved_under_every_effect(times_ms, arrivals, queue_bytes, delay_us, jitter_us, loss):
    effects = LinkSettings(delay_us=delay_us, jitter_us=jitter_us, loss=loss, queue_bytes=queue_bytes)
    link = Link(trace_of_times("t", times_ms), effects)
    now_us, accepted, out, last_us = 0, [], [], 0
    for number, (gap_us, size) in enumerate(arrivals):
        now_us += gap_us
        before = link.counts.accepted_packets
        link.push(now_us, number, size)
        if link.counts.accepted_packets > before:
            accepted.append(number)
    while (t := link.next_delivery_us()) is not None:
        assert t >= last_us
        last_us = t
        out += link.pop_due(t)
    counts = link.counts
    assert out == accepted
    assert counts.accepted_bytes == counts.delivered_bytes
    assert counts.accepted_bytes + counts.dropped_bytes + counts.lost_bytes == sum(size for _, size in arrivals)
    assert link.queued_bytes(last_us) == 0


@given(TIMES, st.integers(0, 10**6), st.integers(1, 10**6))
def test_capacity_counts_and_times_agree(times_ms, start_us, length_us):
    trace = trace_of_times("t", times_ms)
    for number in range(1, 3 * len(times_ms)):
        assert trace.count_until(trace.time_of(number)) >= number > trace.count_until(trace.time_of(number) - 1)
    bits = trace.mean_bps(start_us, start_us + length_us) * length_us / 1e6
    count = trace.count_until(start_us + length_us) - trace.count_until(start_us)
    assert abs(bits - count * 8 * OPPORTUNITY_BYTES) < 1
