"""Ends of frames that wait on a slow link until it is nearly too late for their display."""

from __future__ import annotations

from dataclasses import replace

import pytest

from cags_protocol import events as ev
from cags_protocol.wire.messages import FrameEnd, ReferenceFrame, TileLayers
from cags_server.ratecontrol.priorities import BASE_PRIORITY
from support.server_scene import SETTINGS
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


@pytest.mark.parametrize("kind", ["difference", "picture"])
def test_a_difference_is_not_made_for_a_frame_whose_end_waits(kind: str) -> None:
    """The client shows no more than a difference assumes, and so would show an older frame."""
    rig = Rig(replace(SETTINGS, references=kind, reserve_s=0.0), gof=12)
    rig.play()
    out = [each for _ in range(6) for each in rig.step(deliver=False)]
    ends = [each for each in out if isinstance(each.message, FrameEnd)]
    made = [reference.frame for reference in of(ReferenceFrame, out)]
    first = min(end.message.frame for end in ends)
    assert max(made, default=0) >= first if kind == "picture" else max(made, default=0) < first
    rig.deliver(ends)
    assert of(ReferenceFrame, rig.step() + rig.step())
