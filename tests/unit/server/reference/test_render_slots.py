"""Places at a renderer that has more to do than it can."""

from __future__ import annotations

from collections import Counter

from hypothesis import given, settings
from hypothesis import strategies as st

from cags_protocol.wire.messages import FrameEnd, ReferenceFrame, TileLayers
from cags_server.reference.render_slots import PATIENCE_US, RENDERS_PER_WORKER, RenderSlots
from support.streamer_rig import Rig, of


def test_only_as_many_are_rendered_as_will_be_done_soon() -> None:
    slots = RenderSlots(workers=2)
    for number in range(2 * RENDERS_PER_WORKER):
        assert slots.may(f"c{number}", 0)
        slots.begun(f"c{number}")
    assert not slots.may("late", 0)
    slots.ended()
    assert slots.may("late", 0)


def test_who_was_turned_away_goes_first() -> None:
    slots = RenderSlots(workers=1)
    for name in ("a", "b"):
        slots.begun(name)
    assert not slots.may("c", 1)
    assert not slots.may("d", 2)
    slots.ended()
    assert not slots.may("a", 3), "c has waited longer"
    assert not slots.may("d", 3)
    assert slots.may("c", 3)
    slots.begun("c")
    slots.ended()
    slots.left("d")
    assert slots.may("a", 4), "nobody else waits any more"


def test_a_turn_that_nobody_takes_is_lost() -> None:
    slots = RenderSlots(workers=1)
    for name in ("a", "b"):
        slots.begun(name)
    assert not slots.may("gone", 0)
    slots.ended()
    assert not slots.may("a", PATIENCE_US)
    assert slots.may("a", PATIENCE_US + 1)


@settings(max_examples=15)
@given(st.integers(1, 3), st.integers(2, 20), st.integers(20, 90))
def test_under_any_load_everybody_is_rendered_for_about_as_often(workers: int, clients: int, work_ms: int) -> None:
    """Clients that are due in the same order every 200 ms; each render takes a worker ``work_ms``."""
    slots, served = RenderSlots(workers), Counter[str]()
    ends: list[int] = []
    for now_ms in range(0, 8000, 5):
        for _ in [end for end in ends if end <= now_ms]:
            slots.ended()
        ends = [end for end in ends if end > now_ms]
        for number in range(clients):
            if (now_ms - 5 * number) % 200 == 0 and slots.may(f"c{number}", now_ms * 1000):
                slots.begun(f"c{number}")
                served[f"c{number}"] += 1
                start_ms = now_ms if len(ends) < workers else sorted(ends)[len(ends) - workers]
                ends.append(start_ms + work_ms)
        assert len(ends) <= RENDERS_PER_WORKER * workers
    counts = [served[f"c{number}"] for number in range(clients)]
    assert min(counts) >= 0.5 * max(counts) - 2


def test_a_frame_without_a_place_is_served_by_what_was_seen() -> None:
    rig = Rig()
    room = [True]
    rig.streamer._may_render = lambda now_us: room[0]
    rig.play()
    rig.step()
    room[0] = False
    out = []
    for _ in range(2):
        due_us = rig.streamer.next_due_us()
        some = rig.streamer.catch_up(due_us)
        assert rig.streamer.begin(due_us) is None or not some
        rig.deliver(some)
        out += some
    assert [e.frame for e in of(FrameEnd, out)] == [2, 3]
    assert of(TileLayers, out)
    assert of(ReferenceFrame, out) == []
    room[0] = True
    assert [r.frame for r in of(ReferenceFrame, rig.step())] == [3]
