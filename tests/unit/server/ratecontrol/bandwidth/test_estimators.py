import pytest

from cags_protocol.events import AckSample, Stance
from cags_protocol.wire.limits import PACKET_BYTES
from cags_server.ratecontrol.bandwidth import MeasuredEstimator, OracleEstimator

RTT_US = 40_000


def feed(estimator: MeasuredEstimator, mbps: float, *, start_ms: int, ms: int, queued: bool, app_limited: bool) -> None:
    """Acknowledgements every 5 ms of a link (or an application) of this rate."""
    for t in range(start_ms, start_ms + ms, 5):
        rtt = RTT_US + (40_000 if queued else 0)
        estimator.on_ack(AckSample(t * 1000, int(mbps * 625), rtt, app_limited, delivery_rate_bps=mbps * 1e6))


def mbps(estimator: MeasuredEstimator) -> float:
    return estimator.estimate_bps(0) / 1e6


def allowance(estimator: MeasuredEstimator, now_ms: int = 0) -> float:
    return estimator.allowance_bps(now_ms * 1000) / 1e6


def busy(estimator: MeasuredEstimator, rate: float, start_ms: int, ms: int) -> None:
    feed(estimator, rate, start_ms=start_ms, ms=ms, queued=True, app_limited=False)


def idle(estimator: MeasuredEstimator, rate: float, start_ms: int, ms: int) -> None:
    feed(estimator, rate, start_ms=start_ms, ms=ms, queued=False, app_limited=True)


def test_a_loaded_link_is_measured() -> None:
    estimator = MeasuredEstimator()
    idle(estimator, 1, 0, 5)
    busy(estimator, 20, 5, 1000)
    assert mbps(estimator) == pytest.approx(20, rel=0.02)
    assert allowance(estimator) < 20  # the queue that showed the rate is to be emptied


def test_a_fall_is_followed_within_two_round_trips() -> None:
    estimator = MeasuredEstimator()
    idle(estimator, 1, 0, 5)
    busy(estimator, 20, 5, 1000)
    busy(estimator, 2, 1005, 2 * 80 + 10)
    assert mbps(estimator) < 2.5


def test_an_application_that_sends_little_does_not_pull_the_estimate_down() -> None:
    estimator = MeasuredEstimator()
    idle(estimator, 1, 0, 5)
    busy(estimator, 20, 5, 1000)
    idle(estimator, 0.5, 1005, 20_000)
    assert mbps(estimator) >= 0.9 * 20


def test_sending_what_the_estimate_allows_finds_a_faster_link_within_two_seconds() -> None:
    estimator = MeasuredEstimator()
    idle(estimator, 1, 0, 5)
    busy(estimator, 5, 5, 500)
    for t in range(505, 2505, 50):
        idle(estimator, min(50.0, allowance(estimator, t)), t, 50)
    assert mbps(estimator) > 40


def test_a_fall_is_seen_even_while_little_is_sent() -> None:
    estimator = MeasuredEstimator()
    idle(estimator, 1, 0, 5)
    busy(estimator, 20, 5, 1000)
    for t in range(1005, 1505, 5):  # what waits now was sent when the link was idle
        rtt_us = RTT_US + 200_000
        estimator.on_ack(AckSample(t * 1000, 1250, rtt_us, True, delivery_rate_bps=2e6 * 200 / 240))
    assert mbps(estimator) == pytest.approx(2, rel=0.1)
    idle(estimator, 0.5, 1505, 1000)
    assert mbps(estimator) == pytest.approx(2, rel=0.1), "without a queue, little sent shows nothing"


def test_a_link_that_falls_silent_carries_less_than_a_packet_in_that_time() -> None:
    estimator = MeasuredEstimator()
    idle(estimator, 1, 0, 5)
    busy(estimator, 20, 5, 1000)
    newest = AckSample(1_005_000, 12_500, RTT_US, False, delivery_rate_bps=20e6, in_flight_bytes=30_000)
    estimator.on_ack(newest)
    at_once = estimator.estimate_bps(newest.now_us + RTT_US)
    assert at_once == pytest.approx(20e6, rel=0.05)
    later = [estimator.estimate_bps(newest.now_us + ms * 1000) for ms in (200, 400, 900)]
    assert later[0] > later[1] > later[2]
    assert later[2] < PACKET_BYTES * 8 / 0.8
    assert estimator.allowance_bps(newest.now_us + 900_000) <= 1.2 * later[2]
    estimator.on_ack(AckSample(4_100_000, 12_500, RTT_US, True, delivery_rate_bps=1e6))
    assert estimator.estimate_bps(9_000_000) == pytest.approx(20e6, rel=0.05), "nothing is on its way: no silence"


def test_samples_without_a_rate_change_nothing() -> None:
    estimator = MeasuredEstimator(5e6)
    before = estimator.estimate_bps(0)
    estimator.on_ack(AckSample(0, 0, RTT_US, False, None))
    assert estimator.estimate_bps(0) == before


def test_the_oracle_reads_the_trace_ahead() -> None:
    class Step:
        def mean_bps(self, start_us: int, end_us: int) -> float:
            return float(start_us)

    oracle = OracleEstimator(Step(), origin_us=1_000_000, share=0.5)
    assert oracle.estimate_bps(5_000_000) == 2_000_000
    assert oracle.estimate_bps(0) == 1000  # before the trace, and never zero


def test_a_busy_machine_does_not_look_like_a_loaded_link() -> None:
    estimator = MeasuredEstimator()
    idle(estimator, 1, 0, 5)
    busy(estimator, 20, 5, 1000)
    for number, t in enumerate(range(1005, 6005, 5)):  # round trips jump by 60 ms, whatever is sent
        rtt_us = RTT_US + (60_000 if number % 3 == 0 else 0)
        rate = max(allowance(estimator) * 0.6, 1.0)
        estimator.on_ack(AckSample(t * 1000, int(rate * 625), rtt_us, False, delivery_rate_bps=rate * 1e6))
    assert mbps(estimator) >= 0.8 * 20


def share(estimators: list[MeasuredEstimator], link_mbps: float, seconds: int, rtt_us: int = RTT_US) -> list[float]:
    """Sessions that send all that they may over one link with one queue; what each gets in the last second, Mbps."""
    step_us, waiting, got = 10_000, [0.0] * len(estimators), [0.0] * len(estimators)
    for now_us in range(0, seconds * 1_000_000, step_us):
        waiting = [w + e.allowance_bps(now_us) * step_us / 8e6 for w, e in zip(waiting, estimators, strict=True)]
        room, total = link_mbps * step_us / 8, sum(waiting)
        through = [w * min(1.0, room / total) for w in waiting]
        waiting = [w - t for w, t in zip(waiting, through, strict=True)]
        delay_us = round(sum(waiting) * 8 / link_mbps)
        for estimator, size in zip(estimators, through, strict=True):
            rate = size * 8e6 / step_us
            estimator.on_ack(AckSample(now_us, max(round(size), 1), rtt_us + delay_us, False, delivery_rate_bps=rate))
        if now_us >= (seconds - 1) * 1_000_000:
            got = [g + t * 8 / 1e6 for g, t in zip(got, through, strict=True)]
    return got


@pytest.mark.parametrize("link_mbps", [2.0, 10.0, 40.0])
@pytest.mark.parametrize("sessions", [2, 4])
def test_sessions_that_share_a_link_come_to_equal_rates(link_mbps: float, sessions: int) -> None:
    first = MeasuredEstimator()
    share([first], link_mbps, 3)  # it has the link when the others come
    late = [MeasuredEstimator(0.05e6 * link_mbps) for _ in range(sessions - 1)]
    for estimator in late:
        share([estimator], 0.05 * link_mbps, 1)
    got = share([first, *late], link_mbps, 30)
    assert sum(got) > 0.85 * link_mbps
    assert sum(got) ** 2 > 0.9 * sessions * sum(rate**2 for rate in got), got


def stand(estimator: MeasuredEstimator, stance: Stance, rate: float, start_ms: int, ms: int) -> None:
    """A queue of 200 ms stands; this session's part of the link is ``rate`` Mbps."""
    for t in range(start_ms, start_ms + ms, 5):
        sample = AckSample(t * 1000, int(rate * 625), RTT_US + 200_000, False, rate * 1e6, stance=stance)
        estimator.on_ack(sample)


def test_a_session_that_competes_sends_more_than_it_gets() -> None:
    estimator = MeasuredEstimator()
    idle(estimator, 1, 0, 5)
    stand(estimator, Stance.GIVE_WAY, 3, 5, 1000)
    assert allowance(estimator) < 3
    stand(estimator, Stance.COMPETE, 3, 1005, 1000)
    assert allowance(estimator) > 3.5


def test_what_was_sent_to_try_a_queue_out_is_forgotten_when_others_hold_it() -> None:
    estimator = MeasuredEstimator()
    idle(estimator, 1, 0, 5)
    stand(estimator, Stance.COMPETE, 3, 5, 2000)
    stand(estimator, Stance.TRY, 2, 2005, 600)
    assert mbps(estimator) == pytest.approx(2, rel=0.1)
    stand(estimator, Stance.COMPETE, 2, 2605, 200)  # sent before the trial ended
    assert mbps(estimator) == pytest.approx(3, rel=0.1)
    stand(estimator, Stance.COMPETE, 2.5, 2805, 1000)
    assert mbps(estimator) == pytest.approx(2.5, rel=0.1)


def test_a_queue_of_others_does_not_show_a_faster_link() -> None:
    """Samples behind a long queue, taken while little was to be sent, tell of falls alone."""
    estimator = MeasuredEstimator()
    idle(estimator, 1, 0, 5)
    busy(estimator, 3, 5, 1000)
    for t in range(1005, 3005, 5):
        estimator.on_ack(AckSample(t * 1000, 1250, RTT_US + 120_000, True, delivery_rate_bps=2.9e6))
    assert mbps(estimator) <= 3.1
