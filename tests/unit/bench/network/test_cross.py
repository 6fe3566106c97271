"""Models of TCP on one bottleneck, and what sessions of the product make of them."""

from __future__ import annotations

import json
import math
import random
from pathlib import Path

import numpy as np
import pytest

from cags_bench.network.checks import checks
from cags_bench.network.cross.bottleneck import Bottleneck, Rival, Station
from cags_bench.network.cross.congestion import CUBIC_ALPHA, RULES, Ack, Bbr, Cubic
from cags_bench.network.cross.experiment import Case, ages, cross_lines, cross_table, fairness
from cags_bench.network.cross.tcp import Flow, Segment
from cags_bench.network.load import Arrivals
from cags_shaper.link import SEGMENT_BYTES, Link, LinkSettings
from cags_shaper.trace import open_trace

TEN_MBPS = "generated:steady-10"
SHORT_US = 20_000_000


def bottleneck(*flows: Flow, loss: float = 0.0, queue_bytes: int = 125_000) -> Bottleneck:
    """Flows that begin half a second apart, over 10 Mbps with a round trip of 50 ms."""
    settings = LinkSettings(25_000, loss=loss, queue_bytes=queue_bytes, seed=3)
    rivals = [Rival(flow, number * 500_000) for number, flow in enumerate(flows)]
    return Bottleneck(Link(open_trace(TEN_MBPS), settings), [], rivals, 10e6)


def share(flow: Flow, seconds: float) -> float:
    return flow.received_bytes * 8 / seconds / 10e6


@pytest.mark.parametrize("rule", RULES)
def test_a_flow_alone_fills_the_link(rule: str) -> None:
    flow = Flow(RULES[rule](), endless=True)
    bottleneck(flow).run(SHORT_US)
    assert 0.88 < share(flow, 20) < 1


def test_bbr_keeps_a_shorter_queue_than_cubic() -> None:
    queues = {}
    for rule in RULES:
        world = bottleneck(Flow(RULES[rule](), endless=True), queue_bytes=375_000)
        world.run(SHORT_US)
        queues[rule] = float(np.median([delay for at_us, delay in world.queue_us if at_us > 5_000_000]))
    assert queues["bbr"] <= 50_000  # two products of rate and round trip at most, one of them on the path
    assert 150_000 < queues["cubic"] <= 300_000


def test_two_cubic_flows_come_to_share_evenly() -> None:
    flows = [Flow(Cubic(), endless=True) for _ in range(2)]
    world = bottleneck(*flows)
    world.run(SHORT_US)
    before = [flow.received_bytes for flow in flows]
    world.run(3 * SHORT_US)
    first, second = (flow.received_bytes - earlier for flow, earlier in zip(flows, before, strict=True))
    assert 0.6 < first / second < 1.7


def test_random_loss_holds_cubic_back_and_bbr_not() -> None:
    flows = {rule: Flow(RULES[rule](), endless=True) for rule in RULES}
    for flow in flows.values():
        bottleneck(flow, loss=0.02).run(SHORT_US)
    reno_bps = (
        SEGMENT_BYTES * 8 / 0.05 * math.sqrt(1.5 / 0.02)
    )  # RFC 9438, section 5.1: the Reno-friendly region rules here
    assert 0.5 * reno_bps < share(flows["cubic"], 20) * 10e6 < 1.6 * reno_bps
    assert share(flows["bbr"], 20) > 0.7


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("loss", [0.0, 0.1])
def test_messages_come_whole_once_and_in_order(rule: str, loss: float) -> None:
    draw = random.Random(7)
    sent = [bytes([number % 251]) * draw.randint(1, 6000) for number in range(300)]
    flow, link = Flow(RULES[rule]()), Link[Segment](open_trace(TEN_MBPS), LinkSettings(5_000, loss=loss, seed=1))
    for message in sent:
        flow.write(message)
    came: list[bytes] = []
    acks: list[tuple[int, Segment]] = []
    now_us = 0
    while len(came) < len(sent):
        assert now_us < 60_000_000
        for segment in link.pop_due(now_us):
            came += flow.arrived(segment)
            acks.append((now_us + 5_000, segment))
        while acks and acks[0][0] <= now_us:
            flow.acknowledged(acks.pop(0)[1], now_us)
        for segment in flow.segments(now_us):
            link.push(now_us, segment, segment.size)
        now_us += 500
    assert came == sent
    assert bool(flow.retransmitted) is bool(loss)


def opened() -> Flow:
    """A flow that knows its round trip, 40 ms, and has nothing under way."""
    flow = Flow(Cubic())
    flow.write(bytes(1000))
    (first,) = flow.segments(0)
    flow.arrived(first)
    flow.acknowledged(first, 40_000)
    return flow


def test_a_lost_tail_is_probed_before_the_timeout() -> None:
    flow = opened()
    flow.write(bytes(100))
    (lost,) = flow.segments(50_000)
    assert flow.next_us() == 50_000 + 80_000
    assert flow.segments(129_999) == []
    (again,) = flow.segments(130_000)
    assert (again.start, again.end) == (lost.start, lost.end)
    assert flow.arrived(again) == [bytes(100)]


def test_after_silence_a_flow_begins_with_one_segment() -> None:
    flow = opened()
    flow.write(bytes(9 * SEGMENT_BYTES))
    assert len(flow.segments(50_000)) > 5
    flow.segments(130_000)  # the probe
    assert len(flow.segments(10_000_000)) == 1
    assert flow.congestion.window_bytes == SEGMENT_BYTES


def test_what_has_come_is_not_sent_again_after_a_timeout() -> None:
    flow = opened()
    flow.write(bytes(3 * SEGMENT_BYTES))
    for segment in flow.segments(50_000):
        flow.arrived(segment)
    flow.segments(130_000)
    assert flow.segments(10_000_000) == []


@pytest.mark.parametrize("carrier", RULES)
def test_two_sessions_share_a_link_evenly(carrier: str) -> None:
    assert Case("none", carrier, 0.0, 1, 30_000_000).figures()["fairness"] > 0.8


def ack(now_us: int, in_flight: float, *, rtt_us: int = 50_000, rate_bps: float = 1e6, began: bool = False) -> Ack:
    return Ack(now_us, SEGMENT_BYTES, rtt_us, round(in_flight * SEGMENT_BYTES), rate_bps, False, began)


def test_cubic_is_back_at_its_window_after_k_seconds() -> None:
    rule = Cubic()
    while rule.window_bytes < 400 * SEGMENT_BYTES:
        rule.on_ack(ack(0, 400))
    rule.on_loss()
    assert rule.window_bytes == pytest.approx(280 * SEGMENT_BYTES, rel=0.01)
    k_s = math.cbrt(400 * 0.3 / 0.4)
    now_us = 0
    while now_us < k_s * 1e6:
        now_us += 250
        rule.on_ack(ack(now_us, rule.window_bytes / SEGMENT_BYTES))
    assert rule.window_bytes == pytest.approx(400 * SEGMENT_BYTES, rel=0.02)


def test_cubic_grows_as_reno_would_where_that_is_faster() -> None:
    rule = Cubic()
    rule.on_loss()  # 10 segments to 7
    for now_us in range(5_000, 1_000_001, 5_000):  # 200 segments in a second, at a round trip of 50 ms
        rule.on_ack(ack(now_us, 20))
    reno = math.sqrt(7**2 + 2 * CUBIC_ALPHA * 140)  # of dW = alpha / W a segment; below the first window
    assert rule.window_bytes / SEGMENT_BYTES > reno * 0.9


def test_a_window_that_is_not_used_does_not_grow() -> None:
    rule = Cubic()
    for now_us in range(1000, 100_000, 1000):
        rule.on_ack(ack(now_us, 2))
    assert rule.window_bytes == 10 * SEGMENT_BYTES


def test_bbr_looks_for_the_round_trip_every_ten_seconds() -> None:
    rule = Bbr()
    for now_us in range(0, 10_300_000, 10_000):
        rule.on_ack(ack(now_us, 6, rtt_us=50_000 if now_us < 10_000 else 60_000, began=True))
    assert rule.window_bytes == 4 * SEGMENT_BYTES
    for now_us in range(10_300_000, 10_900_000, 10_000):
        rule.on_ack(ack(now_us, 3, rtt_us=50_000, began=True))
    assert rule.window_bytes > 4 * SEGMENT_BYTES


def test_a_session_alone_gets_its_link_over_either() -> None:
    for rule in RULES:
        station = Station(Flow(RULES[rule]()), 300_000)
        settings = LinkSettings(10_000, queue_bytes=125_000)
        Bottleneck(Link(open_trace(TEN_MBPS), settings), [station], [], 10e6).run(8_000_000)
        assert share(station.flow, 7.7) > 0.75
        assert len(station.log.references) > 200


def test_fairness_is_jains() -> None:
    assert fairness([0.3, 0.3]) == pytest.approx(1)
    assert fairness([0.4, 0.0]) == pytest.approx(0.5)
    assert fairness([0.0, 0.0]) == 1


def test_the_age_is_that_of_the_newest_frame_that_has_come() -> None:
    log = Arrivals(references=[(100_000, 60_000), (200_000, 50_000)])  # planned at 40 and 150 ms
    assert list(ages(log, 0, 100_000, 220_001)[[0, 9, 10, 12]]) == [60_000, 150_000, 50_000, 70_000]
    assert list(ages(log, 50_000, 150_000, 160_000)) == [60_000]  # its clock began later
    assert list(ages(Arrivals(), 50_000, 150_000, 160_000)) == [100_000]  # nothing has come


def test_to_go_on_is_the_same_as_to_go_at_once() -> None:
    at_once, in_parts = Flow(Cubic(), endless=True), Flow(Cubic(), endless=True)
    bottleneck(at_once).run(4_000_000)
    world = bottleneck(in_parts)
    for until_us in (1_000_000, 2_500_000, 4_000_000):
        world.run(until_us)
    assert in_parts.received_bytes == at_once.received_bytes


@pytest.fixture
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures from the second second on: what they are does not matter."""
    monkeypatch.setattr("cags_bench.network.cross.experiment.SETTLE_US", 1_500_000)


@pytest.mark.usefixtures("soon")
def test_the_same_seed_gives_the_same_figures() -> None:
    case = Case("cubic", "bbr", 0.02, 4, 3_000_000)
    assert case.figures() == case.figures()


@pytest.mark.usefixtures("soon")
def test_lines_have_pairs_and_intervals() -> None:
    lines = list(cross_lines(500_000, 2, 1))
    assert [(line["rival"], line["carrier"], line["loss"]) for line in lines[:4]] == [
        ("none", "cubic", 0.0), ("none", "cubic", 0.02), ("none", "bbr", 0.0), ("none", "bbr", 0.02),
    ]  # fmt: skip
    assert len(lines) == 12
    assert all(("age_p99_ratio" in line) is bool(line["loss"]) for line in lines)
    for line in lines:
        low, high = line["share_interval"]
        assert low <= line["share"] <= high


def test_checks_judge_the_worst() -> None:
    calm = {"case": "cross", "loss": 0.0, "share_least": 0.3, "share_rival": 0.3, "fairness": 0.99}
    lossy = {**calm, "loss": 0.02, "age_p99_ratio": 1.5}
    good = [{**calm, "rival": "none"}, {**calm, "rival": "cubic"}, {**lossy, "rival": "cubic"}]
    assert [entry["ok"] for entry in checks(good)] == [True] * 4
    bad = [{**line, "share_least": 0.1, "share_rival": 0.1, "fairness": 0.8, "age_p99_ratio": 2.1} for line in good]
    assert [entry["ok"] for entry in checks(bad)] == [False] * 4


def test_the_page_s_table_is_that_of_the_committed_lines() -> None:
    docs = Path(__file__).parents[4] / "docs"
    lines = [json.loads(line) for line in (docs / "cross.jsonl").read_text(encoding="utf-8").splitlines()]
    assert cross_table([line for line in lines if "case" in line]) in (docs / "lab/network.md").read_text(
        encoding="utf-8"
    )
