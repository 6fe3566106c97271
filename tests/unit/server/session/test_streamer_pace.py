"""When frames are planned: ahead of their display, late, skipped, and while a picture is still being rendered."""

from dataclasses import replace

import pytest

from cags_protocol import events as ev
from cags_protocol.wire.messages import FrameEnd, ReferenceFrame, ReferenceKind, TileLayers
from cags_server.link.pace import MARGIN_US
from cags_server.session.schedule import JUMP_US, LONGEST_LEAD_US, MOST_PASSED, POOR
from cags_server.visibility.visibility import Visibility
from support.server_scene import SETTINGS
from support.streamer_rig import OFFSET_US, PERIOD_US, Rig, of


def next_references(rig: Rig) -> list[ReferenceFrame]:
    """Those of the next step that has any."""
    return next(found for found in (of(ReferenceFrame, rig.step()) for _ in range(40)) if found)


def test_frames_are_planned_a_lead_before_their_display_in_the_servers_clock() -> None:
    rig = Rig()
    rig.play()
    rig.streamer._schedule.client_lacks(0.0)
    lead_us = SETTINGS.lead_frames * PERIOD_US
    assert rig.streamer.next_due_us() == pytest.approx(OFFSET_US + 300_000 - lead_us, abs=1)
    rig.step()
    assert rig.streamer.lacking > POOR, "the client has nothing yet: references are predicted less far"
    assert rig.frame_due_us() > OFFSET_US + 300_000 + PERIOD_US - lead_us
    rig.streamer._schedule.client_lacks(0.0)
    assert rig.streamer.next_due_us() == pytest.approx(OFFSET_US + 300_000 + PERIOD_US - lead_us, abs=1)


def test_late_frames_are_skipped_but_ended() -> None:
    rig = Rig()
    rig.play()
    rig.step()
    out = rig.step(late_us=int(2.5 * PERIOD_US))
    assert [r.frame for r in of(ReferenceFrame, out)] == [3]
    assert [e.frame for e in of(FrameEnd, out)] == [2, 3, 4]
    assert rig.streamer.stats.frames_skipped == 2


def test_a_late_reference_is_sent_as_long_as_it_serves_and_the_next_is_planned_earlier() -> None:
    rig = Rig(resumes=())  # who comes back is not greeted: nothing is known of the renderer's pace
    rig.play()
    due = rig.streamer.next_due_us()
    job = rig.streamer.begin(due)
    out = rig.streamer.finish(job.run(), due + 300_000)
    assert [r.frame for r in of(ReferenceFrame, out)] == [0]
    assert rig.streamer.stats.records[0].reference_late
    lead = rig.streamer._viewer.clock.to_server(round(300_000 + PERIOD_US)) - rig.streamer.next_due_us()
    assert 300_000 < lead <= LONGEST_LEAD_US


@pytest.mark.parametrize(
    ("took_us", "lead_us"), [(20_000, SETTINGS.lead_frames * PERIOD_US), (60_000_000, LONGEST_LEAD_US)]
)
def test_a_slow_renderer_is_asked_earlier_but_not_ever_earlier(took_us: int, lead_us: float) -> None:
    rig = Rig()
    rig.play()
    rig.streamer._schedule.pace.observe(took_us, 0, 0)
    rig.streamer._schedule.client_lacks(0.0)
    assert rig.streamer._schedule.lead_us == pytest.approx(lead_us, rel=1e-6)


def test_a_reference_too_late_for_anything_is_not_sent() -> None:
    rig = Rig()
    rig.play()
    due = rig.streamer.next_due_us()
    job = rig.streamer.begin(due)
    out = rig.streamer.finish(job.run(), due + 900_000)
    assert of(ReferenceFrame, out) == []
    assert rig.streamer.stats.references_late == 1
    assert [r.idr for r in next_references(rig)] == [True]


def test_at_a_low_rate_media_does_not_wait_a_whole_frame_for_a_slow_job() -> None:
    rig = Rig()
    rig.poses(0, 20_000)
    rig.control("play", rate=1 / 6)
    rig.step()
    due = rig.streamer.next_due_us()
    assert rig.streamer.begin(due) is not None
    lead_us = SETTINGS.lead_frames * PERIOD_US
    assert 0 < rig.streamer.next_due_us() - due <= lead_us / 2, "the rendered frame still reaches its display"
    out = rig.streamer.catch_up(rig.streamer.next_due_us())
    assert [e.frame for e in of(FrameEnd, out)] == [2]
    following_us = rig.streamer.next_due_us() - (due + 6 * PERIOD_US)
    assert 0 < following_us <= lead_us / 3, "and so does the next"


def test_frames_that_were_sent_before_the_play_are_in_time_once_they_are_displayed() -> None:
    rig = Rig()
    rig.poses(0, 20_000)
    rig.control("pause", at_us=20_000)
    for _ in range(6):
        rig.step()
    stats = rig.streamer.stats
    assert (stats.frames_in_time, stats.frames_skipped) == (0, 0)
    rig.control("play", at_us=900_000)
    for _ in range(3):
        rig.step()
    rig.poses(899_999)
    assert stats.frames_in_time == 0, "none is displayed yet"
    rig.poses(900_000 + round(2 * PERIOD_US))
    assert (stats.frames_in_time, stats.frames_late, stats.stalls) == (3, 0, 0)
    rig.poses(900_000 + round(9 * PERIOD_US))
    assert (stats.frames_in_time, stats.frames_late, stats.stalls) == (4, 6, 1), "it was sent up to frame 3"


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
    assert [r.frame for r in of(ReferenceFrame, out)] == [4 + MOST_PASSED]
    assert [e.frame for e in of(FrameEnd, out)] == [5, 6, 7]


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
    for k in (2, 2, 3):
        blind += rig.streamer.catch_up(round(due + (k + 0.1) * PERIOD_US))
    assert rig.streamer.catch_up(round(due + 3.1 * PERIOD_US)) == []
    rig.deliver(blind)
    assert [e.frame for e in of(FrameEnd, blind)] == [2, 3, 4]
    assert {3, 4} <= {t.frame for t in of(TileLayers, blind)}
    assert of(ReferenceFrame, blind) == []
    late = rig.streamer.finish(job.run(), round(due + 3.5 * PERIOD_US))
    assert [r.frame for r in of(ReferenceFrame, late)] == [1]
    assert of(TileLayers, late) == []
    assert [record.frame for record in rig.streamer.stats.records] == [0, 1, 2, 3], "each frame once"
    assert [record.reference_bytes > 0 for record in rig.streamer.stats.records] == [True, True, False, False]
    rendered = rig.streamer.stats.records[1]
    assert (rendered.predicted, rendered.margins) == (job.plan.predicted.pose, job.plan.margins)
    assert [r.frame for r in next_references(rig)] == [5], "the renderer rests for as long as it overran a frame"


def test_a_frame_that_stands_for_a_second_of_others_without_a_render_is_recorded_as_itself() -> None:
    """It was recorded as the first of them, and compared by that one's group."""
    rig = Rig(frames=60)
    rig.play()
    rig.step()
    assert rig.streamer.begin(rig.streamer.next_due_us()) is not None
    rig.streamer.catch_up(rig.streamer.next_due_us())
    rig.deliver(rig.streamer.catch_up(round(rig.streamer.next_due_us() + JUMP_US + 10.5 * PERIOD_US)))
    records = rig.streamer.stats.records
    assert [record.frame for record in records] == [record.tick for record in records]
    assert records[-1].frame > JUMP_US / PERIOD_US


@pytest.mark.parametrize(("slow", "looked_at"), [(False, [5]), (True, [7])])
def test_a_server_that_is_slow_to_plan_looks_at_few_frames_and_ends_all(
    monkeypatch: pytest.MonkeyPatch, slow: bool, looked_at: list[int]
) -> None:
    rig = Rig(replace(SETTINGS, tiles_ahead=3, references="none"), gof=12)
    rig.play()
    for _ in range(2):
        rig.step()
    looks, tiles = [], Visibility.tiles
    monkeypatch.setattr(Visibility, "tiles", lambda self, frame: looks.append(frame) or tiles(self, frame))
    rig.now_us = rig.frame_due_us()
    out = rig.step(late_us=int(2.5 * PERIOD_US) if slow else 0)
    assert looks == looked_at
    assert [end.frame for end in of(FrameEnd, out)] == list(range(5, looked_at[-1] + 1))


@pytest.mark.parametrize("ahead", [1, 3])
def test_frames_between_two_references_get_tiles_and_ends_without_a_reference(ahead: int) -> None:
    """With tiles several frames ahead every frame was taken for one of which nothing had been seen, and rendered."""
    rig = Rig(replace(SETTINGS, reference_every=3, tiles_ahead=ahead), gof=12)
    rig.play()
    kinds = []
    for _ in range(6):
        due = rig.streamer.next_due_us()
        assert rig.streamer.catch_up(due - 1) == []
        out = rig.streamer.catch_up(due)
        rig.deliver(out)
        kinds.append("between" if out else "render")
        if not out:
            out = rig.step()
        assert of(FrameEnd, out)[-1].frame == len(kinds) - 1 + ahead
        assert bool(of(ReferenceFrame, out)) == (kinds[-1] == "render")
    assert kinds == ["render", "between", "between"] * 2
    assert rig.streamer.stats.references_late == 0
    rig.streamer.on_event(ev.KeyframeRequested(99), 0)
    assert of(ReferenceFrame, rig.step())[0].idr


def test_a_new_group_is_entered_without_a_render_when_its_frames_cannot_wait_longer() -> None:
    rig = Rig(replace(SETTINGS, lead_frames=6))
    rig.play()
    for _ in range(4):
        rig.step()
    due = rig.streamer.next_due_us()
    job = rig.streamer.begin(due)
    rig.deliver(rig.streamer.catch_up(rig.streamer.next_due_us()))
    overdue_us = rig.streamer.next_due_us() - round(due + PERIOD_US)
    assert PERIOD_US < overdue_us <= 6 * PERIOD_US / 2 + 1, "a render would choose better"
    assert rig.streamer.catch_up(round(due + 2 * PERIOD_US)) == []
    blind = rig.streamer.catch_up(rig.streamer.next_due_us())
    rig.deliver(blind)
    assert [e.frame for e in of(FrameEnd, blind)] == [6]
    assert {(t.frame, t.tile) for t in of(TileLayers, blind) if t.from_lod == 0} == {(6, k) for k in range(4)}
    late = rig.streamer.finish(job.run(), round(due + 3.5 * PERIOD_US))
    assert [r.frame for r in of(ReferenceFrame, late)] == [4]
    again = rig.step()
    assert not [t for t in of(TileLayers, again) if t.frame == 6 and t.from_lod == 0], "held"


def test_the_first_render_of_a_session_holds_no_frame_up() -> None:
    """With all cores rendering, the first frames of sixteen clients once came after their display."""
    rig = Rig()
    rig.play()
    due = rig.streamer.next_due_us()
    job = rig.streamer.begin(due)
    out = []
    for frame in range(4):
        wake_us = rig.streamer.next_due_us()
        assert wake_us < OFFSET_US + 300_000 + frame * PERIOD_US, "before the display"
        some = rig.streamer.catch_up(wake_us)
        rig.deliver(some)
        out += some
    assert [e.frame for e in of(FrameEnd, out)] == [1, 2, 3, 4]
    assert {t.frame for t in of(TileLayers, out)} >= {1, 2, 3, 4}
    assert rig.streamer.stats.frames == 4
    assert [r.frame for r in of(ReferenceFrame, rig.streamer.finish(job.run(), due + 50_000))] == [0]


def test_a_viewer_who_jumps_back_while_a_render_is_out_is_given_a_beginning() -> None:
    rig = Rig()
    rig.play()
    for _ in range(4):
        rig.step()
    job = rig.streamer.begin(rig.streamer.next_due_us())
    rig.control("seek", 1, 700_000)
    blind = rig.streamer.catch_up(rig.streamer.next_due_us())
    assert {(t.frame, t.tile) for t in of(TileLayers, blind) if t.frame == 0} == {(0, k) for k in range(4)}
    assert [e.frame for e in of(FrameEnd, blind)] == [0, 1, 2]
    assert rig.streamer.finish(job.run(), OFFSET_US) == [], "of the play before the seek"


def test_only_frames_that_the_client_displays_are_rendered_and_planned() -> None:
    rig = Rig()
    rig.play()
    rig.streamer.on_event(ev.PosesReceived((), OFFSET_US, 600), OFFSET_US)
    due, rendered, ends = rig.streamer.next_due_us(), [], []
    for _ in range(5):
        out = rig.step()
        rendered += [r.frame for r in of(ReferenceFrame, out)]
        ends.append([e.frame for e in of(FrameEnd, out)])
    assert rendered == [0, 2, 4, 5, 7]
    assert ends == [[1, 2], [3, 4], [5], [6, 7], [8, 9]]
    assert [r.ticks_covered for r in rig.streamer.stats.records] == [1, 2, 2, 1, 2], "each earns the bytes of its time"
    assert rig.streamer.next_due_us() - due == pytest.approx(9 * PERIOD_US, abs=2)


def test_a_client_that_displays_every_frame_again_is_planned_every_frame_at_once() -> None:
    rig = Rig()
    rig.play()
    rig.streamer.on_event(ev.PosesReceived((), OFFSET_US, 250), OFFSET_US)
    rig.step()
    rig.streamer.on_event(ev.PosesReceived((), OFFSET_US), OFFSET_US)
    assert [r.frame for r in of(ReferenceFrame, rig.step())] == [1]


def test_late_renders_of_a_slow_client_are_of_frames_that_it_displays() -> None:
    rig = Rig()
    rig.play()
    rig.streamer.on_event(ev.PosesReceived((), OFFSET_US, 500), OFFSET_US)
    rig.step()
    assert [r.frame for r in of(ReferenceFrame, rig.step(late_us=int(3.5 * PERIOD_US)))] == [4]


def test_a_slow_client_is_served_blind_at_its_own_frames_too() -> None:
    rig = Rig()
    rig.play()
    rig.streamer.on_event(ev.PosesReceived((), OFFSET_US, 500), OFFSET_US)
    rig.step()
    due = rig.streamer.next_due_us()
    assert rig.streamer.begin(due) is not None
    ends = []
    for k in range(3, 8):
        ends += [e.frame for e in of(FrameEnd, rig.streamer.catch_up(round(due + k * PERIOD_US)))]
    assert ends == [3, 4, 5, 6, 7, 8]


def test_the_last_frame_of_a_clip_is_planned_in_any_case() -> None:
    rig = Rig()
    rig.play()
    rig.streamer.on_event(ev.PosesReceived((), OFFSET_US, 250), OFFSET_US)
    rendered = [r.frame for _ in range(4) for r in of(ReferenceFrame, rig.step())]
    assert rendered == [0, 4, 8, 11]
    assert rig.streamer.next_due_us() is None


def test_a_late_render_of_a_slow_client_does_not_go_past_the_end() -> None:
    rig = Rig()
    rig.play()
    rig.streamer.on_event(ev.PosesReceived((), OFFSET_US, 250), OFFSET_US)
    rig.step()
    assert [r.frame for r in of(ReferenceFrame, rig.step(late_us=int(9.5 * PERIOD_US)))] == [11]
    assert rig.streamer.next_due_us() is None


def test_frames_are_counted_on_through_a_loop() -> None:
    rig = Rig()
    rig.poses(0, 20_000)
    rig.control("play", loop=True)
    rig.streamer.on_event(ev.PosesReceived((), OFFSET_US, 400), OFFSET_US)
    planned = []
    for _ in range(10):
        rig.step()
        planned.append(rig.streamer.stats.records[-1].tick)
    assert planned == [0, 3, 5, 8, 10, 13, 15, 18, 20, 23]


def test_a_frame_that_found_no_place_at_the_renderer_is_told_from_a_late_one() -> None:
    rig = Rig()
    rig.play()
    rig.step()
    rig.streamer._may_render = lambda now_us: False
    rig.step()
    rig.streamer._may_render = lambda now_us: True
    rig.step()
    assert [(record.no_place, record.reference_late) for record in rig.streamer.stats.records] == [
        (False, False), (True, False), (False, False),
    ]  # fmt: skip


def test_references_are_light_while_the_renderer_says_so() -> None:
    rig = Rig()
    rig.play()
    light = []
    for number in range(6):
        rig.streamer._lightly = lambda number=number: 2 <= number < 4
        rig.step()
        light.append(rig.streamer.stats.light.references)
    assert light == [0, 0, 1, 2, 2, 2]
    assert rig.streamer.stats.careful.references == 5, "with the greeting"
    assert rig.streamer.lacking is not None


def be_short(rig: Rig) -> None:
    """Let the machine have taken too long for references, often."""
    for _ in range(20):
        rig.streamer._worth.made(slowly=True)


def test_on_a_short_machine_references_are_left_out_where_tiles_will_do() -> None:
    rig = Rig(replace(SETTINGS, references="auto"))
    rig.play()
    be_short(rig)
    sent = [out for _ in range(9) for out in rig.step()]
    kinds = [ReferenceKind(each.kind) for each in of(ReferenceFrame, sent)]
    assert kinds.count(ReferenceKind.NOTHING) <= 1, "that the last one is not to be shown any more is said once"
    assert len(kinds) <= 2  # until it was known what is lacking
    ended = [end.frame for end in of(FrameEnd, sent)]
    assert ended == list(range(ended[0], ended[0] + len(ended)))
    assert rig.streamer.stats.references <= 2  # renders that only look are none


@pytest.mark.parametrize("references", ["difference", "picture"])
def test_references_that_were_asked_for_are_made_on_a_short_machine_too(references: str) -> None:
    rig = Rig(replace(SETTINGS, references=references))
    rig.play()
    be_short(rig)
    sent = [out for _ in range(6) for out in rig.step()]
    assert len(of(ReferenceFrame, sent)) == 6


def test_a_client_that_pauses_is_moved_on_though_no_references_are_made() -> None:
    """It shows what its last reference assumes, and no further than the newest mark: both must rise."""
    rig = Rig(replace(SETTINGS, references="auto"))
    rig.play()
    be_short(rig)
    for _ in range(6):
        rig.step()
    rig.control("pause", 2, 400_000)
    before = len(rig.marks)
    told = of(ReferenceFrame, [out for _ in range(9) for out in rig.step()])
    assert len(told) >= 2
    assert {ReferenceKind(each.kind) for each in told} == {ReferenceKind.NOTHING}
    bases = [each.basis for each in told]
    assert bases == sorted(set(bases))
    assert set(bases) <= {mark.number for mark in rig.marks[before:]}


def test_references_that_come_late_are_planned_earlier_only_while_the_clip_plays() -> None:
    rig = Rig()
    rig.play()
    due = rig.streamer.next_due_us()
    out = rig.streamer.finish(rig.streamer.begin(due).run(), due)
    reference = next(each for each in out if isinstance(each.message, ReferenceFrame))
    caution = rig.streamer._schedule.pace
    display_us = rig.streamer._viewer.clock.to_server(300_000)
    rig.streamer.on_event(ev.Delivered(reference, display_us + 30_000), display_us + 30_000)
    assert caution.caution_us == 30_000 + MARGIN_US
    rig.control("pause")
    rig.streamer.on_event(ev.Delivered(reference, display_us + 90_000), display_us + 90_000)
    assert caution.caution_us == 30_000 + MARGIN_US
