"""A link's effects: absent ones cost nothing and change nothing, named ones are felt."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_common.passes import LinkEffect
from cags_shaper.link import Link, LinkSettings
from cags_shaper.trace import open_trace

# Every effect on, at a strength that can be felt by no packet: what an "always on" link would compute.
UNFELT = {
    LinkEffect.LOSS: {"loss": 1e-300},
    LinkEffect.QUEUE: {"queue_bytes": 1 << 60, "queue_packets": 1 << 60},
    LinkEffect.CAP: {"cap_bps": 1e12},
}
FELT = {
    LinkEffect.DELAY: {"delay_us": 5_000},
    LinkEffect.JITTER: {"jitter_us": 5_000},
    LinkEffect.LOSS: {"loss": 0.3},
    LinkEffect.QUEUE: {"queue_bytes": 3_000},
    LinkEffect.CAP: {"cap_bps": 1e6},
}
bursts = st.lists(st.tuples(st.integers(0, 20_000), st.integers(1, 9_000)), min_size=20, max_size=60)


def carried(settings: LinkSettings, sends: list[tuple[int, int]], trace: str | None) -> list[tuple[int, int]]:
    """Which packets come out of a link, and when."""
    link: Link[int] = Link(open_trace(trace) if trace else None, settings)
    now, out = 0, []
    for number, (wait, size) in enumerate(sends):
        now += wait
        link.push(now, number, size)
    while (due := link.next_delivery_us()) is not None:
        out += [(due, number) for number in link.pop_due(due)]
    return out


@pytest.mark.parametrize("trace", [None, "generated:steady-6"])
@given(sends=bursts, effect=st.sampled_from(sorted(UNFELT)))
def test_an_absent_effect_equals_one_that_is_on_and_not_felt(
    trace: str | None, sends: list[tuple[int, int]], effect: LinkEffect
) -> None:
    base = LinkSettings(delay_us=1_000)
    on = replace(base, **UNFELT[effect])
    assert effect in on.effects(rated=trace is not None)
    assert effect not in base.effects(rated=trace is not None)
    plain, always = carried(base, sends, trace), carried(on, sends, trace)
    assert [n for _, n in plain] == [n for _, n in always]
    # A cap of 1 Tbit/s takes 72 ns for 9,000 bytes, and the clock ticks in microseconds.
    slack_us = len(sends) if effect is LinkEffect.CAP else 0
    assert all(abs(a - b) <= slack_us for (a, _), (b, _) in zip(plain, always, strict=True))


@pytest.mark.parametrize("effect", sorted(FELT))
def test_a_named_effect_is_felt(effect: LinkEffect) -> None:
    sends = [(200, 1_400)] * 60
    trace = "generated:steady-6"
    assert carried(LinkSettings(**FELT[effect]), sends, trace) != carried(LinkSettings(), sends, trace)  # type: ignore[arg-type]


def test_effects_follow_the_settings() -> None:
    link: Link[bytes] = Link(None)
    assert not link.effects
    link.change(delay_us=10, loss=0.1, queue_packets=3)
    assert link.effects == {LinkEffect.DELAY, LinkEffect.LOSS, LinkEffect.QUEUE}
    link.change(loss=0.0, cap_bps=1e6)
    assert link.effects == {LinkEffect.DELAY, LinkEffect.QUEUE, LinkEffect.CAP}
    assert Link[bytes](open_trace("generated:steady-6")).effects == {LinkEffect.RATE}
