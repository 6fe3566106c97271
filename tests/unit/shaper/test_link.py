import pytest

from cags_common.errors import ConfigError
from cags_shaper.link import Link, LinkSettings, tcp_wire_bytes
from cags_shaper.trace import trace_of_times


def link(times, **settings):
    return Link(trace_of_times("t", times), LinkSettings(**settings))


def run(shaped, until_us):
    out = []
    while (t := shaped.next_delivery_us()) is not None and t <= until_us:
        out += [(t, data) for data in shaped.pop_due(t)]
    return out


def test_a_packet_leaves_at_the_next_opportunity():
    shaped = link([5, 10])
    assert shaped.push(1000, "a", 1504)
    assert run(shaped, 10**6) == [(5000, "a")]


def test_an_opportunity_at_the_very_moment_of_arrival_is_missed():
    shaped = link([5, 10])
    shaped.push(5000, "a", 100)
    assert run(shaped, 10**6) == [(10_000, "a")]


def test_an_opportunity_carries_several_small_packets():
    shaped = link([5, 10])
    for name in "abcd":
        shaped.push(0, name, 500)
    assert run(shaped, 10**6) == [(5000, "a"), (5000, "b"), (5000, "c"), (10_000, "d")]


def test_a_packet_is_split_over_opportunities():
    shaped = link([5, 10])
    shaped.push(0, "a", 1000)
    shaped.push(0, "b", 1000)
    assert run(shaped, 10**6) == [(5000, "a"), (10_000, "b")]


def test_unused_opportunities_are_lost():
    shaped = link([1, 2, 3, 4, 5, 100])
    shaped.push(5000, "late", 1504 * 2)
    assert run(shaped, 10**7) == [(101_000, "late")]


def test_large_messages_take_as_many_opportunities_as_they_need():
    shaped = link([5, 5, 5, 10])
    shaped.push(0, "a", 1504 * 3 + 1)
    assert run(shaped, 10**6) == [(10_000, "a")]


def test_the_trace_repeats():
    shaped = link([4])
    for i in range(3):
        shaped.push(0, i, 1504)
    assert run(shaped, 10**6) == [(4000, 0), (8000, 1), (12_000, 2)]


def test_without_loop_what_is_left_never_comes():
    shaped = Link(trace_of_times("t", [4], loop=False))
    assert shaped.push(0, "a", 1504)
    assert shaped.push(0, "b", 1504)
    assert run(shaped, 10**9) == [(4000, "a")]
    assert shaped.next_delivery_us() is None
    assert shaped.coming_packets == 1


def test_the_queue_is_drop_tail_in_bytes_and_excludes_the_packet_being_served():
    shaped = link([5, 10, 15], queue_bytes=2000)
    assert shaped.push(0, "a", 1504)
    assert not shaped.push(0, "b", 1504)
    assert shaped.push(0, "c", 400)
    assert shaped.next_room_us() == 5000
    assert shaped.push(5000, "d", 1504)
    assert [data for _, data in run(shaped, 10**6)] == ["a", "c", "d"]
    assert shaped.counts.dropped_packets == 1


def test_the_queue_is_drop_tail_in_packets():
    shaped = link([5, 10], queue_packets=2)
    assert [shaped.push(0, i, 10) for i in range(3)] == [True, True, False]


def test_delay_is_added_after_the_rate():
    shaped = link([5, 10], delay_us=20_000)
    shaped.push(0, "a", 1504)
    shaped.push(0, "b", 1504)
    assert run(shaped, 10**6) == [(25_000, "a"), (30_000, "b")]


def test_without_a_trace_only_named_effects_remain():
    shaped = Link(None, LinkSettings(delay_us=7))
    shaped.push(3, "a", 10**6)
    assert run(shaped, 100) == [(10, "a")]
    assert Link(None).settings == LinkSettings()


def test_a_named_but_zero_effect_changes_nothing():
    plain, named = link([3, 7]), link([3, 7], delay_us=0, jitter_us=0, loss=0.0, seed=5)
    for i in range(20):
        assert plain.push(i * 900, i, 700) == named.push(i * 900, i, 700)
    assert run(plain, 10**7) == run(named, 10**7)


def test_jitter_delays_and_keeps_the_order():
    shaped = link([1], jitter_us=5000, seed=1)
    for i in range(200):
        shaped.push(i * 1000, i, 1000)
    out = run(shaped, 10**9)
    assert [data for _, data in out] == list(range(200))
    extra = [t - (i + 1) * 1000 for t, i in out]
    assert min(extra) >= 0
    assert sum(extra) / 200 > 3000


def test_loss_takes_its_share_and_no_more():
    shaped = link([1], loss=0.2, seed=1)
    assert all(shaped.push(i * 1000, i, 1000) for i in range(5000))
    assert shaped.counts.lost_packets == pytest.approx(1000, rel=0.1)
    assert shaped.counts.accepted_packets + shaped.counts.lost_packets == 5000


def test_the_size_is_that_of_the_data_unless_given():
    shaped = link([5, 10])
    shaped.push(0, b"x" * 1505)
    assert shaped.counts.accepted_bytes == 1505
    with pytest.raises(ValueError, match="at least 1"):
        shaped.push(0, b"")


@pytest.mark.parametrize(
    "wrong", [{"delay_us": -1}, {"jitter_us": -1}, {"loss": 1.0}, {"queue_bytes": 0}, {"queue_packets": 0}]
)
def test_settings_out_of_range_are_refused_by_name(wrong):
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        LinkSettings(**wrong)


def test_tcp_headers_are_counted():
    assert tcp_wire_bytes(1448) == 1500
    assert tcp_wire_bytes(1449) == 1449 + 104
