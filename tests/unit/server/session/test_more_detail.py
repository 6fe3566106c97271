"""Tiles that go between two frames, where the next one is not due for longer than a frame."""

from __future__ import annotations

from dataclasses import replace

from cags_protocol.wire.messages import FrameEnd, ReferenceFrame, TileLayers
from support.server_scene import SETTINGS
from support.streamer_rig import PERIOD_US, Rig, of

LONGER_US = 90_000


def after_a_fall_of_the_lead(link_bps: float) -> tuple[Rig, float]:
    """A stream whose lead has just become shorter by :data:`LONGER_US`, and when its newest frame was planned."""
    rig = Rig(replace(SETTINGS, reserve_s=0.0), initial_bps=link_bps, gof=12)
    rig.play()
    pace = rig.streamer._schedule.pace
    pace.caution_us = LONGER_US
    for _ in range(2):
        rig.step()
        pace.caution_us = LONGER_US
    pace.caution_us = 0.0
    return rig, rig.now_us


def test_detail_goes_on_while_the_next_frame_is_not_due() -> None:
    rig, planned_us = after_a_fall_of_the_lead(1e5)
    ended = rig.streamer._tiles.ended
    sent = []
    while (due_us := rig.streamer.next_due_us()) < rig.frame_due_us():
        out = rig.catch_up(due_us)
        rig.deliver(out)
        assert not of(FrameEnd, out) and not of(ReferenceFrame, out)
        sent += of(TileLayers, out)
    assert sent and planned_us + PERIOD_US - 1 <= rig.now_us < planned_us + PERIOD_US + LONGER_US
    assert rig.streamer._tiles.ended == ended
    rig.step()
    assert rig.streamer._tiles.ended == ended + 1, "frames go on as before"


def test_nothing_is_planned_between_frames_that_lack_nothing() -> None:
    rig, planned_us = after_a_fall_of_the_lead(50e6)
    assert rig.streamer.next_due_us() > planned_us + LONGER_US


def test_what_nobody_has_seen_is_not_due_again_and_again() -> None:
    rig, planned_us = after_a_fall_of_the_lead(1e5)
    assert rig.streamer.next_due_us() < rig.frame_due_us()
    rig.streamer._visibility.tells_of = lambda frame: False
    assert rig.streamer.next_due_us() == rig.frame_due_us() > planned_us


def test_a_control_ends_it() -> None:
    rig, _ = after_a_fall_of_the_lead(1e5)
    rig.control("seek", 6, at_us=10_000_000)
    assert rig.streamer._planner.detail_due_us() is None
