"""References on links that do not bear their video."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from cags_protocol import events as ev
from cags_protocol.wire.messages import FrameEnd, ReferenceFrame
from cags_server.link.reference_budget import BURST_S, ReferenceBudget
from support.links import KnownLink
from support.server_scene import SETTINGS
from support.streamer_rig import Rig, of

SPARE_US = 400_000
SIZES = st.lists(st.integers(500, 20_000), min_size=30, max_size=200)


@given(SIZES, st.floats(1e5, 1e8), st.floats(0.1, 0.9), st.integers(5_000, 200_000))
def test_what_is_spent_stays_within_the_share(sizes: list[int], link_bps: float, share: float, step_us: int) -> None:
    budget, spent, largest = ReferenceBudget(KnownLink(link_bps), share), 0, 0
    for number, size in enumerate(sizes):
        if budget.bears(number * step_us, SPARE_US):
            budget.spent(number, size)
            budget.left(number)
            spent, largest = spent + size, max(largest, size)
    seconds = (len(sizes) - 1) * step_us / 1e6
    assert spent <= link_bps * share / 8 * (seconds + BURST_S) + largest + 1


def test_a_debt_is_worked_off_and_savings_are_bounded() -> None:
    budget = ReferenceBudget(KnownLink(800_000), 0.5)
    assert budget.bears(0, SPARE_US)  # 50,000 bytes a second
    budget.spent(0, 37_500)  # a quarter of a second was saved: 12,500 bytes
    budget.left(0)
    assert not budget.bears(499_000, SPARE_US)
    assert budget.bears(501_000, SPARE_US)
    assert budget.bears(60_000_000, SPARE_US)
    budget.spent(1, 12_501)
    assert not budget.bears(60_000_000, SPARE_US), "no more than the burst was saved in a minute"


def test_all_of_the_link_is_no_bound() -> None:
    budget = ReferenceBudget(KnownLink(1e5), 1.0)
    for number in range(100):
        assert budget.bears(number, SPARE_US)
        budget.spent(number, 10_000)
        budget.left(number)


def test_none_goes_that_what_is_in_flight_would_make_late() -> None:
    link = KnownLink(8e6)
    budget = ReferenceBudget(link, 1.0)
    link.told(in_flight_bytes=SPARE_US - 1)  # a byte a microsecond
    assert budget.bears(0, SPARE_US)
    link.told(in_flight_bytes=SPARE_US)
    assert not budget.bears(1, SPARE_US)
    link.rate_bps = 9e6
    assert budget.bears(2, SPARE_US)


def test_none_goes_that_those_that_wait_would_make_late() -> None:
    link = KnownLink(8e6)
    budget = ReferenceBudget(link, 1.0)
    assert budget.bears(0, SPARE_US)
    budget.spent(1, SPARE_US // 2)
    budget.spent(2, SPARE_US // 2)
    assert not budget.bears(0, SPARE_US)
    budget.left(1)
    budget.left(1)  # sent, and lost afterwards
    assert budget.bears(0, SPARE_US)
    link.told(in_flight_bytes=SPARE_US // 2)
    assert not budget.bears(0, SPARE_US)


def played(link_bps: float, most: float) -> list[ev.Outgoing]:
    """Five frames of one group at a constant estimate."""
    rig = Rig(
        replace(SETTINGS, reference_share=min(most, 0.2), reference_most=most, reference_kbps=400),
        initial_bps=link_bps,
        gof=12,
    )
    rig.play()
    out: list[ev.Outgoing] = []
    for _ in range(5):
        due_us = rig.streamer.next_due_us()
        some = rig.streamer.catch_up(due_us) or rig.step()
        rig.streamer.on_event(ev.KeyframeRequested(99), 0)  # asked for or not: a key frame would only weigh more
        rig.deliver(some)
        out += some
    assert [e.frame for e in of(FrameEnd, rig.opening + out)] == [0, 1, 2, 3, 4, 5]
    return rig.greeting + out


def test_a_slow_link_gets_fewer_references_and_every_frames_end() -> None:
    free, fast, slow = (len(of(ReferenceFrame, played(bps, most))) for bps, most in ((2e5, 1), (5e7, 0.5), (2e5, 0.05)))
    assert free == fast == 6
    assert 1 <= slow < 6
