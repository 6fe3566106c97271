"""Ends of frames that wait on a slow link until it is nearly too late for their display; the class, and a stream."""

from __future__ import annotations

from dataclasses import replace

import pytest

from cags_common.bundle.manifest import MotionSteps
from cags_protocol import events as ev
from cags_protocol.wire.messages import FrameEnd, ReferenceFrame, TileLayers
from cags_server.ratecontrol.priorities import BASE_PRIORITY
from cags_server.session.waiting_ends import WaitingEnds
from support.server_scene import SETTINGS, FakeReader, library
from support.streamer_rig import OFFSET_US, PERIOD_US, Rig, of

START_US = 300_000
"""Display of frame 0, by the client's clock."""


def planned(rig: Rig, frames: int) -> list[ev.Outgoing]:
    """The ends of the next frames; all else is delivered."""
    out = [each for _ in range(frames) for each in rig.step(deliver=False)]
    rig.deliver([each for each in out if not isinstance(each.message, FrameEnd)])
    return [each for each in out if isinstance(each.message, FrameEnd)]


def taken_back(rig: Rig, ends: list[ev.Outgoing], now_us: int) -> list[ev.Outgoing]:
    """What goes instead of ``ends``, as far as they are outdated."""
    rig.now_us = now_us
    rig.drop([each for each in ends if rig.streamer.outdated(each, now_us)], "cancelled")
    return rig.streamer.take_late_ends(now_us)


def displayed(frame: int) -> int:
    """When ``frame`` is displayed, by the server's clock."""
    return OFFSET_US + START_US + round(frame * PERIOD_US)


def test_the_newest_late_end_stands_for_those_that_name_no_splats_and_they_go_first() -> None:
    rig = Rig()
    rig.play()
    ends = planned(rig, 3)
    assert [(each.message.frame, bool(each.payload)) for each in ends] == [(1, False), (2, True), (3, False)]
    assert {each.priority for each in ends} == {BASE_PRIORITY}
    assert taken_back(rig, ends, displayed(-1)) == [], "two periods before its display there is time"
    again = taken_back(rig, ends, displayed(3) + 1)
    assert [(end.frame, each.payload) for end, each in zip(of(FrameEnd, again), again, strict=True)] == [
        (2, ends[1].payload),
        (3, b""),
    ]
    assert all(each.urgent for each in again) and not any(each.urgent for each in ends)
    rig.deliver(again)
    assert not rig.streamer.outdated(again[0], displayed(3) + 1), "it is gone"


def test_a_late_end_that_went_late_again_is_taken_back_again() -> None:
    rig = Rig()
    rig.play()
    ends = planned(rig, 2)
    again = taken_back(rig, ends, displayed(2) + 1)
    assert [end.frame for end in of(FrameEnd, taken_back(rig, again, displayed(3)))] == [2]


def test_an_end_that_was_dropped_for_good_is_forgotten() -> None:
    rig = Rig()
    rig.play()
    ends = planned(rig, 2)
    rig.drop(ends, "overflow")
    assert not any(rig.streamer.outdated(end, displayed(9)) for end in ends)
    assert rig.streamer.take_late_ends(displayed(9)) == []


def test_ends_before_a_jump_do_not_come_back_after_it() -> None:
    rig = Rig()
    rig.play()
    ends = planned(rig, 2)
    rig.control("seek", 6, at_us=START_US + 500_000)
    rig.drop(ends, "cancelled")
    assert rig.streamer.take_late_ends(displayed(11)) == []


def test_tiles_are_outdated_as_before() -> None:
    rig = Rig()
    rig.play()
    out = rig.step(deliver=False)
    tile = next(each for each in out if isinstance(each.message, TileLayers))
    assert not rig.streamer.outdated(tile, displayed(0) - 1)
    assert rig.streamer.outdated(tile, displayed(tile.message.frame) + round(4 * PERIOD_US))


@pytest.mark.parametrize(
    ("kind", "moves", "made_for_it"),
    [("difference", True, False), ("difference", False, True), ("picture", True, True)],
)
def test_a_difference_is_not_made_for_a_frame_whose_end_waits(kind: str, moves: bool, made_for_it: bool) -> None:
    """The client shows no more than a difference assumes, and so would show an older frame. Without motion that is
    better than the newer one: splats are sent anew for every frame, and V3-A lost 13 dB.
    """
    reader = FakeReader(frames=24, gof=12)
    reader.manifest = replace(reader.manifest, motion=MotionSteps((0.1,), (0.1,)) if moves else None)
    rig = Rig(replace(SETTINGS, references=kind, reserve_s=0.0), served=library(reader))
    rig.play()
    out = [each for _ in range(6) for each in rig.step(deliver=False)]
    ends = [each for each in out if isinstance(each.message, FrameEnd)]
    made = [reference.frame for reference in of(ReferenceFrame, out)]
    first = min(end.message.frame for end in ends)
    assert (max(made, default=0) >= first) is made_for_it
    rig.deliver(ends)
    assert of(ReferenceFrame, rig.step() + rig.step())


def end(frame: int, payload: bytes = b"") -> ev.Outgoing:
    return ev.Outgoing(FrameEnd(frame), payload, priority=1)


def test_an_end_waits_from_its_queueing_until_it_leaves() -> None:
    ends = WaitingEnds()
    ends.queued([end(3), end(4)], 1000)
    ends.queued([end(5)], 2000)
    assert ends.has(4, 1000) and not ends.has(4, 999) and not ends.has(6, 9999)
    assert ends.any_until(1000) and not ends.any_until(999)
    assert [ends.left(3), ends.left(4), ends.left(4)] == [1000, 1000, None]
    assert not ends.any_until(1999) and ends.any_until(2000)
    ends.clear()
    assert not ends.any_until(10**12)


def test_the_newest_and_those_that_name_splats_are_queued_again() -> None:
    ends = WaitingEnds()
    for each in (end(1), end(2, b"ids"), end(3)):
        ends.taken_back(each, 1000)
    again = ends.again()
    assert [(each.message.frame, each.urgent) for each in again] == [(2, True), (3, True)]
    assert ends.again() == []
    assert ends.has(3, 1000) and not ends.has(1, 1000), "they wait again"


def test_what_was_taken_back_before_a_control_stays_away() -> None:
    ends = WaitingEnds()
    ends.taken_back(end(1), 1000)
    ends.clear()
    assert ends.again() == []
