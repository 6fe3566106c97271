"""The compressed soak of ``cags-bench network``, short in CI and a whole day at night, and hypothesis' own weather."""

import random

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from cags_bench.network.soak import Faults, run_soak
from cags_protocol import ServerSessionSettings, State
from cags_protocol import events as ev
from cags_protocol.wire import messages as m
from cags_shaper.trace import open_trace
from support.wire_fuzz import fuzzed
from support.wire_pair import Pair, reference, tile

MINUTE_US = 60_000_000
CLEAN = {"lost", "malformed", "unexpected", "timeout", "bye"}


def check(result):
    assert result.sent_again == 0
    assert result.unsettled == 0
    assert result.messages > 0
    assert {ending.split(": ")[1] for ending in result.endings} <= CLEAN
    assert result.max_queued_bytes <= ServerSessionSettings().max_queue_bytes
    assert result.max_partial_bytes <= 4 * 2**20


def test_three_minutes_of_ordinary_trouble():
    check(run_soak(open_trace("generated:lte-driving"), 3 * MINUTE_US))


@pytest.mark.parametrize("seed", range(3))
def test_half_a_minute_of_constant_trouble(seed):
    faults = Faults(damage=0.01, double=0.05, swap=0.05, disconnects_per_s=0.1, controls_per_s=1)
    result = run_soak(open_trace("generated:5g-mmwave"), MINUTE_US // 2, seed, faults)
    check(result)
    assert result.connections > 3
    assert result.resumed_tiles > 0


def test_two_soaks_are_the_same():
    trace = open_trace("generated:lte-driving")
    assert run_soak(trace, MINUTE_US // 6, 5) == run_soak(trace, MINUTE_US // 6, 5)


@pytest.mark.nightly
@pytest.mark.timeout(7200)
def test_a_day():
    check(run_soak(open_trace("generated:lte-driving"), 24 * 60 * MINUTE_US))


class Weather(RuleBasedStateMachine):
    """Sessions under any order of traffic, faults, controls, garbage and endings."""

    @initialize(seed=st.integers(0, 2**32))
    def begin(self, seed):
        self.rng = random.Random(seed)
        self.sent, self.settled, self.frame = 0, 0, 0
        self.connect()

    def connect(self):
        self.pair = Pair(server=ServerSessionSettings(max_queue_bytes=300_000)).open()

    @rule(size=st.integers(0, 60_000), priority=st.integers(0, 3), stale_ms=st.none() | st.integers(0, 300))
    def send_tile(self, size, priority, stale_ms):
        self.frame += 1
        deadline_us = None if stale_ms is None else self.pair.now_us + stale_ms * 1000
        self.send(tile(self.frame, 0, size, priority=priority, deadline_us=deadline_us, key=self.frame % 5))

    @rule(size=st.integers(0, 5000))
    def send_reference(self, size):
        self.frame += 1
        self.send(reference(self.frame, self.frame, size, key="reference"))

    def send(self, outgoing):
        self.sent += 1
        self.pair.queue(outgoing)

    @rule(ms=st.integers(1, 3000))
    def wait(self, ms):
        self.pair.run(ms * 1000)

    @rule(mbps=st.floats(0.1, 500))
    def estimate(self, mbps):
        self.pair.server.rate_hint_bps = mbps * 1e6

    @rule(action=st.sampled_from(["play", "pause", "seek", "rate"]), frame=st.integers(0, 100))
    def control(self, action, frame):
        self.pair.client.control(m.Control(action, frame, self.pair.now_us), now_us=self.pair.now_us)
        if action == "seek":
            self.pair.server.cancel(lambda outgoing: True, now_us=self.pair.now_us)

    @rule(frames=st.lists(st.integers(0, 100), max_size=600))
    def evict(self, frames):
        self.pair.client.report_evictions(m.InventoryEntry(frame, 0, 0) for frame in frames)

    @rule(damage=st.floats(0, 0.1), lose=st.floats(0, 0.3), double=st.floats(0, 0.5), late_ms=st.integers(1, 300))
    def bad_weather(self, damage, lose, double, late_ms):
        self.pair.down = self.fate(damage, lose, double, late_ms)
        self.pair.up = self.fate(0.0, lose, double, late_ms)

    @rule()
    def fair_weather(self):
        self.pair.down = self.pair.up = lambda data: [(5000, data)]

    @rule(to_server=st.booleans())
    def garbage(self, to_server):
        session = self.pair.server if to_server else self.pair.client
        session.receive(fuzzed(self.rng), now_us=self.pair.now_us)

    @rule(server=st.booleans(), cut=st.booleans())
    def leave(self, server, cut):
        session = self.pair.server if server else self.pair.client
        if cut:
            session.connection_lost("cut", now_us=self.pair.now_us)
        else:
            session.bye("enough", now_us=self.pair.now_us)
        self.reconnect()

    def reconnect(self):
        self.pair.run(1000)
        for session in (self.pair.server, self.pair.client):
            session.connection_lost("over", now_us=self.pair.now_us)
        self.pair.run(0)
        self.settled += len(self.pair.server_events(ev.Delivered)) + len(self.pair.server_events(ev.Dropped))
        assert self.pair.server.in_flight_bytes == self.pair.server.queued_bytes == 0
        assert len(self.pair.server_events(ev.Closed)) == len(self.pair.client_events(ev.Closed)) == 1
        self.connect()

    def fate(self, damage, lose, double, late_ms):
        def of(data):
            copies = [] if self.rng.random() < lose else [data] * (1 + (self.rng.random() < double))
            return [(self.rng.randrange(late_ms * 1000), self.damaged(damage, copy)) for copy in copies]

        return of

    def damaged(self, damage, data):
        if self.rng.random() >= damage:
            return data
        broken = bytearray(data)
        broken[self.rng.randrange(len(broken))] ^= 1 << self.rng.randrange(8)
        return bytes(broken)

    @invariant()
    def bounded(self):
        if not hasattr(self, "pair"):
            return
        server, client = self.pair.server, self.pair.client
        assert 0 <= server.queued_bytes <= 300_000
        assert server.in_flight_bytes >= 0
        assert client.partial_bytes <= 32 * 2**20
        for session in (server, client):
            assert session.closed == (session.state is State.CLOSED)
            assert session.closed or session.next_timer_us() is not None

    def teardown(self):
        if hasattr(self, "pair"):
            self.reconnect()
            assert self.settled == self.sent


Weather.TestCase.settings = settings(max_examples=25, stateful_step_count=40)
test_any_weather = Weather.TestCase
