"""Estimators at both ends of what links do, clocks that jump, and sums over a long session."""

import math

import pytest

from cags_server.link import OracleLink
from cags_server.session.clock import ClientClock
from cags_shaper.link import Link
from cags_shaper.trace import open_trace
from support.links import ToldLink


@pytest.mark.parametrize("rate", [1.0, 64e3, 1e6, 1e9, 10e9, 1e15])
def test_the_measured_rate_stays_finite_and_bounded_at_any_true_rate(rate):
    link = ToldLink()
    for i in range(300):
        size = max(1, min(int(rate / 8 / 100), 1 << 30))
        link.ack(i * 10_000, size, 40_000 if i else 10_000, False, rate)
        for value in (link.estimate_bps(i * 10_000), link.allowance_bps(i * 10_000)):
            assert math.isfinite(value)
            assert 0 < value <= 10e9


@pytest.mark.parametrize("rate", [0.0, None, -1.0])
def test_samples_that_say_nothing_change_nothing(rate):
    link = ToldLink()
    before = link.estimate_bps(0)
    for i in range(50):
        link.ack(i, 0, 20_000, False, rate)
    assert link.estimate_bps(50) == before


def test_a_dead_link_then_a_fast_one_is_followed():
    link = ToldLink()
    now = 0
    for rate in (1e5, 50e6):
        for _ in range(200):
            now += 10_000
            link.ack(now, int(rate / 800), 60_000 if now > 10_000 else 20_000, False, rate)
        assert link.estimate_bps(now) == pytest.approx(rate, rel=0.1)


def test_the_oracle_survives_a_blackout():
    oracle = OracleLink(open_trace("generated:blackout"))
    rates = [oracle.estimate_bps(t) for t in range(0, 60_000_000, 100_000)]
    assert all(math.isfinite(rate) and rate >= 0 for rate in rates)
    assert 0 < min(rates) <= 1e3 < max(rates), "never zero: budgets divide by it"


def test_a_client_clock_that_jumps_is_believed_again_within_the_window():
    clock = ClientClock()
    for t in range(0, 1_000_000, 10_000):
        clock.observe(t, t + 5_000_000)
    assert clock.offset_us == 5_000_000
    for t in range(0, 12_000_000, 10_000):  # the client's clock fell back by a second
        clock.observe(t, t + 7_000_000)
    assert clock.offset_us == 7_000_000


@pytest.mark.parametrize("jump_us", [-(10**15), -1, 0, 1, 10**15])
def test_any_jump_keeps_the_two_directions_inverse(jump_us):
    clock = ClientClock()
    clock.observe(1_000, 5_000)
    clock.observe(1_000 + jump_us, 6_000)
    assert clock.to_client(clock.to_server(123_456)) == 123_456


def test_a_link_accounts_every_byte_of_a_hundred_megabytes():
    link: Link[int] = Link(open_trace("generated:steady-150"))
    size, pushed, received, now = 60_000, 0, 0, 0
    while pushed < 100_000_000 or received < pushed:
        while pushed < 100_000_000 and link.queued_bytes(now) < 1_000_000:
            assert link.push(now, size, size)
            pushed += size
        due = link.next_delivery_us()
        if due is None:
            break
        now = max(now, due)
        received += sum(link.pop_due(now))
    assert received == pushed == link.counts.delivered_bytes
    assert received * 8 / now == pytest.approx(150, rel=0.01), "bits a microsecond: no rounding adds up"
