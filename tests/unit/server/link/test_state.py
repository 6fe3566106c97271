"""What is known of a link, whoever estimates its rate."""

from __future__ import annotations

import pytest

from cags_protocol.events import AckSample
from cags_server.link.measured import MeasuredLink
from cags_server.link.oracle import OracleLink
from cags_server.link.state import LinkState
from cags_shaper.trace import open_trace
from support.links import KnownLink

SAMPLE = AckSample(
    1_000_000, 8_192, 40_000, True, 5e6, in_flight_bytes=9_000, undecoded_bytes=77, shortest_rtt_us=30_000
)


def test_nothing_is_on_its_way_before_the_first_acknowledgement() -> None:
    newest = KnownLink().newest
    assert (newest.rtt_us, newest.shortest_rtt_us, newest.in_flight_bytes, newest.undecoded_bytes) == (0, 0, 0, 0)


@pytest.mark.parametrize("link", [MeasuredLink(), OracleLink(open_trace("generated:steady-20")), KnownLink()])
def test_every_link_keeps_what_the_newest_acknowledgement_said(link: LinkState) -> None:
    link.on_ack(SAMPLE)
    assert link.newest is SAMPLE
    assert SAMPLE.queue_us == 10_000


def test_bytes_go_through_at_the_estimated_rate() -> None:
    assert KnownLink(8e6).through_us(5_000, 0) == 5_000
    assert OracleLink(open_trace("generated:steady-20")).through_us(2_500, 0) == pytest.approx(1_000, rel=0.05)
