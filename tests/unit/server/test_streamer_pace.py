"""When frames are planned: ahead of their display, late, skipped, and while a picture is still being rendered."""

from dataclasses import replace

import pytest

from cags_protocol import events as ev
from cags_protocol.messages import FrameEnd, ReferenceFrame, TileLayers
from support.server_scene import SETTINGS
from support.streamer_rig import OFFSET_US, PERIOD_US, Rig, of


def test_frames_are_planned_a_lead_before_their_display_in_the_servers_clock() -> None:
    rig = Rig()
    rig.play()
    lead_us = SETTINGS.lead_frames * PERIOD_US
    assert rig.streamer.next_due_us() == pytest.approx(OFFSET_US + 300_000 - lead_us, abs=1)
    rig.step()
    assert rig.streamer.next_due_us() == pytest.approx(OFFSET_US + 300_000 + PERIOD_US - lead_us, abs=1)


def test_late_frames_are_skipped_but_ended() -> None:
    rig = Rig()
    rig.play()
    rig.step()
    out = rig.step(late_us=int(2.5 * PERIOD_US))
    assert [r.frame for r in of(ReferenceFrame, out)] == [3]
    assert [e.frame for e in of(FrameEnd, out)] == [1, 2, 3]
    assert rig.streamer.stats.frames_skipped == 2


def test_a_late_reference_is_sent_as_long_as_it_serves_and_the_next_is_planned_earlier() -> None:
    rig = Rig()
    rig.play()
    due = rig.streamer.next_due_us()
    job = rig.streamer.begin(due)
    out = rig.streamer.finish(job.run(), due + 300_000)
    assert [r.frame for r in of(ReferenceFrame, out)] == [0]
    assert rig.streamer.stats.records[0].reference_late
    lead = rig.streamer._viewer.clock.to_server(round(300_000 + PERIOD_US)) - rig.streamer.next_due_us()
    assert 300_000 < lead <= 3 * SETTINGS.lead_frames * PERIOD_US


def test_a_reference_too_late_for_anything_is_not_sent() -> None:
    rig = Rig()
    rig.play()
    due = rig.streamer.next_due_us()
    job = rig.streamer.begin(due)
    out = rig.streamer.finish(job.run(), due + 900_000)
    assert of(ReferenceFrame, out) == []
    assert rig.streamer.stats.references_late == 1
    assert [r.idr for r in of(ReferenceFrame, rig.step())] == [True]


def test_at_a_low_rate_media_does_not_wait_a_whole_frame_for_a_slow_job() -> None:
    rig = Rig()
    rig.poses(0, 20_000)
    rig.control("play", rate=1 / 6)
    rig.step()
    due = rig.streamer.next_due_us()
    assert rig.streamer.begin(due) is not None
    overdue_us = rig.streamer.next_due_us() - (due + 6 * PERIOD_US)
    assert 0 < overdue_us <= SETTINGS.lead_frames * PERIOD_US / 3, "the frame still reaches its display"


def test_one_job_at_a_time_and_a_failed_one_does_not_end_the_stream() -> None:
    rig = Rig()
    rig.play()
    due = rig.streamer.next_due_us()
    job = rig.streamer.begin(due)
    assert rig.streamer.begin(due + 100_000) is None
    rig.streamer.abandon(job)
    assert of(ReferenceFrame, rig.step())[0].idr


def test_frames_skipped_across_a_group_are_ended_too() -> None:
    rig = Rig()
    rig.play()
    for _ in range(4):
        rig.step()
    out = rig.step(late_us=int(3.5 * PERIOD_US))
    assert [r.frame for r in of(ReferenceFrame, out)] == [7]
    assert [e.frame for e in of(FrameEnd, out)] == [4, 5, 6, 7]


def test_without_any_pose_planning_starts_with_the_control_and_skips_nothing() -> None:
    """Once the display time of a Control was believed to be its time of sending, and frames were skipped."""
    rig = Rig()
    rig.control("play", at_us=300_000)
    job = rig.streamer.begin(OFFSET_US + 10_000)
    assert job is not None
    assert (job.plan.frame, job.plan.ticks_covered) == (0, 1)


def test_media_goes_on_while_a_picture_is_being_rendered() -> None:
    rig = Rig()
    rig.play()
    rig.step()
    due = rig.streamer.next_due_us()
    job = rig.streamer.begin(due)
    assert rig.streamer.catch_up(due + 1000) == []
    blind = []
    for k in (2, 3):
        blind += rig.streamer.catch_up(round(due + (k + 0.1) * PERIOD_US))
    rig.deliver(blind)
    assert [e.frame for e in of(FrameEnd, blind)] == [1, 2, 3]
    assert {2, 3} <= {t.frame for t in of(TileLayers, blind)}
    assert of(ReferenceFrame, blind) == []
    late = rig.streamer.finish(job.run(), round(due + 3.5 * PERIOD_US))
    assert [r.frame for r in of(ReferenceFrame, late)] == [1]
    assert of(TileLayers, late) == []
    assert [r.frame for r in of(ReferenceFrame, rig.step())] == [4]


def test_frames_between_two_looks_get_tiles_and_ends_without_a_reference() -> None:
    rig = Rig(replace(SETTINGS, reference_every=3))
    rig.play()
    kinds = []
    for _ in range(6):
        due = rig.streamer.next_due_us()
        assert rig.streamer.catch_up(due - 1) == []
        out = rig.streamer.catch_up(due)
        rig.deliver(out)
        kinds.append("between" if out else "look")
        if not out:
            out = rig.step()
        assert of(FrameEnd, out) or len(kinds) == 1  # the opening held that of the first frame
        assert bool(of(ReferenceFrame, out)) == (kinds[-1] == "look")
    assert kinds == ["look", "between", "between"] * 2
    assert rig.streamer.stats.references_late == 0
    rig.streamer.on_event(ev.KeyframeRequested(99), 0)
    assert of(ReferenceFrame, rig.step())[0].idr


def test_a_new_group_is_not_entered_without_looking() -> None:
    rig = Rig()
    rig.play()
    for _ in range(5):
        rig.step()
    due = rig.streamer.next_due_us()
    rig.streamer.begin(due)
    assert rig.streamer.catch_up(round(due + 2.5 * PERIOD_US)) == []
    assert rig.streamer.next_due_us() is None  # nothing to wake up for until the job is done
