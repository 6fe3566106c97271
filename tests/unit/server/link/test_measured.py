"""The rate of a link, measured from acknowledgements alone."""

import pytest

from cags_protocol.events import Stance
from cags_protocol.wire.limits import PACKET_BYTES
from support.links import ToldLink

RTT_US = 40_000


def feed(link: ToldLink, mbps: float, *, start_ms: int, ms: int, queued: bool, app_limited: bool) -> None:
    """Acknowledgements every 5 ms of a link (or an application) of this rate."""
    for t in range(start_ms, start_ms + ms, 5):
        rtt = RTT_US + (40_000 if queued else 0)
        link.ack(t * 1000, int(mbps * 625), rtt, app_limited, rate=mbps * 1e6)


def mbps(link: ToldLink) -> float:
    return link.estimate_bps(0) / 1e6


def allowance(link: ToldLink, now_ms: int = 0) -> float:
    return link.allowance_bps(now_ms * 1000) / 1e6


def busy(link: ToldLink, rate: float, start_ms: int, ms: int) -> None:
    feed(link, rate, start_ms=start_ms, ms=ms, queued=True, app_limited=False)


def idle(link: ToldLink, rate: float, start_ms: int, ms: int) -> None:
    feed(link, rate, start_ms=start_ms, ms=ms, queued=False, app_limited=True)


def test_a_loaded_link_is_measured() -> None:
    link = ToldLink()
    idle(link, 1, 0, 5)
    busy(link, 20, 5, 1000)
    assert mbps(link) == pytest.approx(20, rel=0.02)
    assert allowance(link) < 20  # the queue that showed the rate is to be emptied


def test_a_fall_is_followed_within_two_round_trips() -> None:
    link = ToldLink()
    idle(link, 1, 0, 5)
    busy(link, 20, 5, 1000)
    busy(link, 2, 1005, 2 * 80 + 10)
    assert mbps(link) < 2.5


def test_a_fall_is_followed_soon_however_long_what_is_in_flight_makes_round_trips() -> None:
    link = ToldLink()
    idle(link, 1, 0, 5)
    busy(link, 20, 5, 1000)
    for t in range(1005, 1225, 20):  # one second of the slow link is in flight
        link.ack(t * 1000, 1250, RTT_US + 1_000_000, False, rate=5e5)
    assert mbps(link) < 1


def test_an_application_that_sends_little_does_not_pull_the_estimate_down() -> None:
    link = ToldLink()
    idle(link, 1, 0, 5)
    busy(link, 20, 5, 1000)
    idle(link, 0.5, 1005, 20_000)
    assert mbps(link) >= 0.9 * 20


def test_sending_what_the_estimate_allows_finds_a_faster_link_within_two_seconds() -> None:
    link = ToldLink()
    idle(link, 1, 0, 5)
    busy(link, 5, 5, 500)
    for t in range(505, 2505, 50):
        idle(link, min(50.0, allowance(link, t)), t, 50)
    assert mbps(link) > 40


def test_a_fall_is_seen_even_while_little_is_sent() -> None:
    link = ToldLink()
    idle(link, 1, 0, 5)
    busy(link, 20, 5, 1000)
    for t in range(1005, 1505, 5):  # what waits now was sent when the link was idle
        rtt_us = RTT_US + 200_000
        link.ack(t * 1000, 1250, rtt_us, True, rate=2e6 * 200 / 240)
    assert mbps(link) == pytest.approx(2, rel=0.1)
    idle(link, 0.5, 1505, 1000)
    assert mbps(link) == pytest.approx(2, rel=0.1), "without a queue, little sent shows nothing"


def test_a_link_that_falls_silent_carries_less_than_a_packet_in_that_time() -> None:
    link = ToldLink()
    idle(link, 1, 0, 5)
    busy(link, 20, 5, 1000)
    newest_us = 1_005_000
    link.ack(newest_us, 12_500, RTT_US, False, 20e6, in_flight_bytes=30_000)
    at_once = link.estimate_bps(newest_us + RTT_US)
    assert at_once == pytest.approx(20e6, rel=0.05)
    later = [link.estimate_bps(newest_us + ms * 1000) for ms in (200, 400, 900)]
    assert later[0] > later[1] > later[2]
    assert later[2] < PACKET_BYTES * 8 / 0.8
    assert link.allowance_bps(newest_us + 900_000) <= 1.2 * later[2]
    link.ack(4_100_000, 12_500, RTT_US, True, rate=1e6)
    assert link.estimate_bps(9_000_000) == pytest.approx(20e6, rel=0.05), "nothing is on its way: no silence"


def test_samples_without_a_rate_change_nothing() -> None:
    link = ToldLink(5e6)
    before = link.estimate_bps(0)
    link.ack(0, 0, RTT_US, False, None)
    assert link.estimate_bps(0) == before


def test_a_busy_machine_does_not_look_like_a_loaded_link() -> None:
    link = ToldLink()
    idle(link, 1, 0, 5)
    busy(link, 20, 5, 1000)
    for number, t in enumerate(range(1005, 6005, 5)):  # round trips jump by 60 ms, whatever is sent
        rtt_us = RTT_US + (60_000 if number % 3 == 0 else 0)
        rate = max(allowance(link) * 0.6, 1.0)
        link.ack(t * 1000, int(rate * 625), rtt_us, False, rate=rate * 1e6)
    assert mbps(link) >= 0.8 * 20


def share(links: list[ToldLink], link_mbps: float, seconds: int, rtt_us: int = RTT_US) -> list[float]:
    """Sessions that send all that they may over one link with one queue; what each gets in the last second, Mbps."""
    step_us, waiting, got = 10_000, [0.0] * len(links), [0.0] * len(links)
    for now_us in range(0, seconds * 1_000_000, step_us):
        waiting = [w + e.allowance_bps(now_us) * step_us / 8e6 for w, e in zip(waiting, links, strict=True)]
        room, total = link_mbps * step_us / 8, sum(waiting)
        through = [w * min(1.0, room / total) for w in waiting]
        waiting = [w - t for w, t in zip(waiting, through, strict=True)]
        delay_us = round(sum(waiting) * 8 / link_mbps)
        for link, size in zip(links, through, strict=True):
            rate = size * 8e6 / step_us
            link.ack(now_us, max(round(size), 1), rtt_us + delay_us, False, rate=rate)
        if now_us >= (seconds - 1) * 1_000_000:
            got = [g + t * 8 / 1e6 for g, t in zip(got, through, strict=True)]
    return got


@pytest.mark.parametrize("link_mbps", [2.0, 10.0, 40.0])
@pytest.mark.parametrize("sessions", [2, 4])
def test_sessions_that_share_a_link_come_to_equal_rates(link_mbps: float, sessions: int) -> None:
    first = ToldLink()
    share([first], link_mbps, 3)  # it has the link when the others come
    late = [ToldLink(0.05e6 * link_mbps) for _ in range(sessions - 1)]
    for link in late:
        share([link], 0.05 * link_mbps, 1)
    got = share([first, *late], link_mbps, 30)
    assert sum(got) > 0.85 * link_mbps
    assert sum(got) ** 2 > 0.9 * sessions * sum(rate**2 for rate in got), got


def stand(link: ToldLink, stance: Stance, rate: float, start_ms: int, ms: int) -> None:
    """A queue of 200 ms stands; this session's part of the link is ``rate`` Mbps."""
    for t in range(start_ms, start_ms + ms, 5):
        link.ack(t * 1000, int(rate * 625), RTT_US + 200_000, False, rate * 1e6, stance=stance)


def test_a_session_that_competes_sends_more_than_it_gets() -> None:
    link = ToldLink()
    idle(link, 1, 0, 5)
    stand(link, Stance.GIVE_WAY, 3, 5, 1000)
    assert allowance(link) < 3
    stand(link, Stance.COMPETE, 3, 1005, 1000)
    assert allowance(link) > 3.5


def test_what_was_sent_to_try_a_queue_out_is_forgotten_when_others_hold_it() -> None:
    link = ToldLink()
    idle(link, 1, 0, 5)
    stand(link, Stance.COMPETE, 3, 5, 2000)
    stand(link, Stance.TRY, 2, 2005, 600)
    assert mbps(link) == pytest.approx(2, rel=0.1)
    stand(link, Stance.COMPETE, 2, 2605, 200)  # sent before the trial ended
    assert mbps(link) == pytest.approx(3, rel=0.1)
    stand(link, Stance.COMPETE, 2.5, 2805, 1000)
    assert mbps(link) == pytest.approx(2.5, rel=0.1)


def test_a_queue_of_others_does_not_show_a_faster_link() -> None:
    """Samples behind a long queue, taken while little was to be sent, tell of falls alone."""
    link = ToldLink()
    idle(link, 1, 0, 5)
    busy(link, 3, 5, 1000)
    for t in range(1005, 3005, 5):
        link.ack(t * 1000, 1250, RTT_US + 120_000, True, rate=2.9e6)
    assert mbps(link) <= 3.1
