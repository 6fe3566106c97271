"""Tiles go out a few frames before the reference that assumes them."""

from __future__ import annotations

import uuid
from dataclasses import replace
from typing import Any

import pytest

from cags_common.geometry import Pose
from cags_common.raster.base import Footprint
from cags_common.tiles.kinds import TileKind
from cags_protocol import events as ev
from cags_protocol.wire.messages import FrameEnd, Mark, ReferenceFrame, TileLayers
from cags_server.reference.job import FrameJob
from cags_server.session.schedule import MOST_PASSED
from cags_server.settings import PLAIN
from cags_server.visibility.visibility import Visibility
from support.moving_bundle import moving_library
from support.server_scene import BIRTH, SETTINGS, FakeReader, FakeScene, hello, library
from support.streamer_rig import OFFSET_US, Rig, of

AHEAD = 3
BEHIND = Pose.looking_at((0, 0, 0), (0, 0, -3), (0, -1, 0))
FAR = replace(SETTINGS, tiles_ahead=AHEAD)


def ends(outgoing: list[ev.Outgoing]) -> list[int]:
    return [end.frame for end in of(FrameEnd, outgoing)]


def first_levels(outgoing: list[ev.Outgoing]) -> list[tuple[int, int]]:
    return [(tile.frame, tile.tile) for tile in of(TileLayers, outgoing) if tile.from_lod == 0]


def test_the_tiles_and_the_end_of_a_later_frame_go_with_a_reference() -> None:
    rig = Rig(FAR)
    rig.play()
    out = rig.step()
    assert [reference.frame for reference in of(ReferenceFrame, out)] == [0]
    assert ends(out) == [1, 2, 3]
    assert {frame for frame, _ in first_levels(out)} == {1, 2, 3}
    record = rig.streamer.stats.records[-1]
    assert (record.frame, record.ahead.frame) == (0, AHEAD)
    period_us = 1e6 / rig.library.manifest.fps
    assert record.ahead.display_us - record.display_us == pytest.approx(AHEAD * period_us, abs=1)
    late_us = OFFSET_US + round(FAR.tile_deadline_ms * 1000)
    for each in out:
        if isinstance(each.message, TileLayers) and each.message.from_lod == 0:
            display_us = record.display_us + each.message.frame * period_us
            assert each.deadline_us == pytest.approx(late_us + display_us, abs=2)
    assert ends(rig.step()) == [4]


def test_of_frames_that_end_together_each_ends_as_soon_as_its_own_tiles_are_there() -> None:
    rig = Rig(FAR)
    rig.play()
    out = [each.message for each in rig.step()]
    for frame in (1, 2, 3):
        end = next(at for at, message in enumerate(out) if isinstance(message, FrameEnd) and message.frame == frame)
        base = [message for message in out if isinstance(message, TileLayers) and message.from_lod == 0]
        assert {message.frame for message in base if out.index(message) < end} == set(range(1, frame + 1))


@pytest.mark.parametrize("seed", [3, 11, 13, 16])
def test_what_begins_in_many_frames_passed_over_goes_too(seed: int) -> None:
    """It went with later frames, if ever: what moves stood still, and what changes looked as before."""
    scene = moving_library(f"memory://{uuid.uuid4().hex}", seed)
    rig = Rig(replace(SETTINGS, tiles_ahead=5), served=scene)
    rig.play()
    out = rig.step()
    begins = {
        (tile.frame, tile.tile): tile.kind
        for frame in range(1, 5)
        for tile in rig.streamer._visibility.tiles(frame)
        if tile.frame == frame and (tile.looks is None or tile.looks[0] == 0)
    }
    assert {TileKind.MOTION, TileKind.LOOKS} <= set(begins.values())
    assert set(begins) <= {*first_levels(rig.opening), *first_levels(out)}
    assert ends(out) == [1, 2, 3, 4, 5]


@pytest.mark.parametrize("references", ["auto", "none"])
def test_a_late_render_without_a_reference_is_of_the_oldest_frame_that_is_due(references: str) -> None:
    """It skipped frames as if it had to be in time for a reference."""
    rig = Rig(replace(FAR, references=references))
    rig.play()
    for _ in range(3):
        rig.step()
    while rig.streamer._between_references(rig.now_us):
        rig.step()
    before = rig.streamer.stats.records[-1].frame
    rig.step(late_us=round(2.5e6 / rig.library.manifest.fps))
    assert rig.streamer.stats.records[-1].frame == before + (3 if references == "auto" else 1)


@pytest.mark.parametrize("references", ["auto", "difference"])
@pytest.mark.parametrize("ahead", [1, 3, 30])
def test_every_frame_of_a_clip_ends_once_and_every_tile_comes(ahead: int, references: str) -> None:
    rig = Rig(replace(SETTINGS, tiles_ahead=ahead, references=references))
    rig.play()
    sent = list(rig.opening)
    while rig.streamer.next_due_us() is not None:
        out = rig.step()
        frame = rig.streamer.stats.records[-1].frame
        assert rig.streamer.stats.records[-1].ahead.frame == min(frame + ahead, 11)
        sent += out
    assert ends(sent) == list(range(12))
    brought = first_levels(sent)
    assert len(brought) == len(set(brought))
    if ahead < 6:  # what is seen of one group of frames at a time
        assert set(brought) == {(frame, tile.tile) for frame in range(12) for tile in rig.library.entry(frame).tiles}


def test_a_client_that_displays_more_frames_again_has_not_gone_back() -> None:
    rig = Rig(FAR)
    rig.play()
    sent = list(rig.opening)
    for permille in (500, 500, 1000, 1000, 1000, 300, 1000, 1000):
        poses = ev.PosesReceived((), rig.now_us, permille)
        rig.streamer.on_event(poses, rig.now_us)
        sent += rig.step()
        assert not of(Mark, rig.take_marks())
    ended = ends(sent)
    assert ended == sorted(set(ended))
    brought = first_levels(sent)
    assert len(brought) == len(set(brought))


def test_at_the_border_of_a_group_the_next_ones_tiles_come_before_its_first_reference() -> None:
    rig = Rig(FAR)
    rig.play()
    outs = [rig.step() for _ in range(5)]
    keys = {(6, tile) for tile in range(4)}
    assert not any(keys & set(first_levels(out)) for out in outs[:3])
    assert keys <= set(first_levels(outs[3]))
    assert [ends(out) for out in outs[2:]] == [[5], [6], [7]]
    rig.step()
    job = rig.streamer.begin(rig.streamer.next_due_us())
    assert (job.plan.frame, job.mirror.scene_at(6, job.plan.basis) is not None) == (6, True)
    assert not any(mark.restart for mark in rig.marks)


def test_frames_skipped_across_a_border_are_ended_too() -> None:
    rig = Rig(FAR)
    rig.play()
    rig.step()
    out = rig.step(late_us=round(4.5e6 / rig.library.manifest.fps))
    assert [reference.frame for reference in of(ReferenceFrame, out)] == [1 + MOST_PASSED]
    assert ends(out) == [4, 5, 6]


def test_ahead_is_counted_in_frames_that_the_client_displays() -> None:
    rig = Rig(FAR)
    rig.play()
    rig.streamer.on_event(ev.PosesReceived((), OFFSET_US, 500), OFFSET_US)
    outs = [rig.step() for _ in range(4)]
    assert [record.ahead.frame for record in rig.streamer.stats.records] == [6, 8, 10, 11]
    assert [ends(out) for out in outs] == [[1, 2, 3, 4, 5, 6], [7, 8], [9, 10], [11]]


def test_a_paused_viewer_gets_the_tiles_of_its_own_frame_and_then_of_the_next_ones() -> None:
    rig = Rig(FAR)
    rig.play()
    rig.step()
    rig.control("pause", 2, 330_000, keeps=True)
    outs = [rig.step() for _ in range(4)]
    assert [of(ReferenceFrame, out)[0].frame for out in outs] == [2] * 4
    assert {record.ahead.frame for record in list(rig.streamer.stats.records)[1:]} == {2}
    assert not any(ends(out) for out in outs), "what it holds has ended"
    assert not any(mark.restart for mark in rig.marks)
    prepared = [frame for out in outs for frame, _ in first_levels(out)]
    assert set(prepared) == {4, 5}, "those of frame 3 it holds"
    assert prepared == sorted(prepared)
    rig.control("play", 2, 900_000, keeps=True)
    out = rig.step()
    assert (ends(out), first_levels(out)) == ([3, 4, 5], [])


def test_what_a_held_play_begins_with_is_there_before_it_begins() -> None:
    """Once the updates of eight frames were due when the first of them was shown, and came after it."""
    rig = Rig(FAR)
    rig.poses(0, 20_000)
    rig.control("pause", 0, 0)
    outs = [rig.step() for _ in range(6)]
    assert {frame for out in outs for frame, _ in first_levels(out)} == set(range(1, AHEAD + 1))
    assert not any(ends(out) for out in outs)
    rig.control("play", 0, 900_000)
    out = rig.step()
    assert (ends(out), first_levels(out)) == ([1, 2, 3], [])
    assert not any(mark.restart for mark in rig.marks)


@pytest.mark.parametrize(
    ("held", "before", "looked_at"),
    [(6, "pause", []), (1, "pause", [1, 2]), (6, "seek", [1, 2])],
    ids=["all was sent", "not all", "forgotten since"],
)
def test_frames_that_were_sent_in_a_hold_are_not_planned_again(
    monkeypatch: pytest.MonkeyPatch, held: int, before: str, looked_at: list[int]
) -> None:
    """On a busy machine the plans of eight frames took 0.2 s, and the ends of the first ones came late."""
    rig = Rig(FAR)
    rig.poses(0, 20_000)
    rig.control("pause", 0, 0)
    for _ in range(held):
        rig.step()
    if before == "seek":
        rig.control("seek", 0, 0, keeps=False)
    looks, tiles = [], Visibility.tiles
    monkeypatch.setattr(Visibility, "tiles", lambda self, frame: looks.append(frame) or tiles(self, frame))
    rig.control("play", 0, 900_000)
    out = rig.step()
    assert (looks, ends(out)[-3:]) == (looked_at, [1, 2, 3])


def test_a_long_hold_fills_the_reserve_frame_by_frame() -> None:
    """The link was idle until the play began, and what its first half second needs went out in one burst then."""
    frames = 7
    rig = Rig(replace(FAR, reserve_s=(frames + 0.5) / library().manifest.fps), gof=12)
    rig.poses(0, 20_000)
    rig.control("pause", 0, 0)
    outs = [rig.step() for _ in range(12)]
    prepared = [frame for out in outs for frame, _ in first_levels(out) if frame]
    assert (prepared, set(prepared)) == (sorted(prepared), set(range(1, frames + 1)))
    rig.control("play", 0, 900_000)
    out = rig.step()
    assert (ends(out), first_levels(out)) == ([1, 2, 3], [])


def test_frames_that_a_late_plan_skips_are_taken_from_the_reserve() -> None:
    """As many frames ahead were passed over at once, half a second before they were due."""
    rig = Rig(replace(FAR, tiles_ahead=1, reserve_s=0.8), gof=12)
    rig.play()
    while rig.streamer._schedule.reserve.frames < 5:
        rig.step()
    before = rig.streamer.stats.records[-1].ahead.frame
    rig.step(late_us=round(2.5e6 / rig.library.manifest.fps))
    assert rig.streamer.stats.records[-1].ticks_covered == 3
    assert rig.streamer.stats.records[-1].ahead.frame <= before + 2


def test_nothing_is_prepared_while_the_frame_on_display_lacks_something_nor_beyond_its_group() -> None:
    rig = Rig(FAR, gof=4)
    rig.poses(0, 20_000)
    rig.control("pause", 2, 0)
    outs = [rig.step() for _ in range(6)]
    assert max(frame for out in outs for frame, _ in first_levels(out)) == 3
    served = library()
    served.reader.manifest = replace(served.manifest, lod_gains_db=(9.0, 9.0, 9.0))
    slow = Rig(FAR, initial_bps=40_000.0, served=served)
    slow.poses(0, 20_000)
    slow.control("pause", 0, 0)
    sent = of(TileLayers, slow.opening + [each for _ in range(40) for each in slow.step()])
    later = [at for at, tile in enumerate(sent) if tile.frame]
    whole = {
        (tile, lod) for tile in range(len(slow.library.entry(0).tiles)) for lod in range(slow.library.manifest.lods)
    }
    first = {(tile.tile, lod) for tile in sent[: later[0]] for lod in range(tile.from_lod, tile.to_lod)}
    assert later, "it is prepared in time"
    assert first == whole


def test_in_a_loop_the_first_frames_end_before_the_last_ones_are_shown() -> None:
    rig = Rig(FAR, gof=12)
    rig.poses(0, 20_000)
    rig.control("play", loop=True, keeps=True)
    outs = [rig.step() for _ in range(24)]
    assert [of(ReferenceFrame, out)[0].frame for out in outs] == [*range(12)] * 2
    assert [record.ahead.frame for record in rig.streamer.stats.records] == [(n + AHEAD) % 12 for n in range(24)]
    assert [ends(out) for out in outs[8:11]] == [[11], [0], [1]]
    assert not any(of(TileLayers, out) for out in outs[9:]), "it holds everything"
    assert not any(mark.restart for mark in rig.marks)


def test_what_comes_into_view_in_the_last_frame_is_sent_though_no_difference_waits_for_it() -> None:
    """It had to come before the reference of its frame is begun; that was past, and so nothing was sent."""
    settings = replace(FAR, references="difference", opening_tiles=False, predictor="hold")
    rig = Rig(settings, joins=hello(BEHIND))
    rig.poses(0, 20_000, pose=BEHIND)
    rig.control("play")
    for _ in range(11):
        assert of(TileLayers, rig.step()) == []
    seen_us = rig.now_us - OFFSET_US
    rig.poses(seen_us, seen_us + 1000)
    assert {(6, tile) for tile in range(4)} <= set(first_levels(rig.step()))
    assert rig.streamer.next_due_us() is None


def test_what_is_seen_ahead_serves_the_frames_without_a_render() -> None:
    rig = Rig(FAR, gof=12)
    rig.play()
    rig.step()
    due_us = rig.streamer.next_due_us()
    job = rig.streamer.begin(due_us)
    period_us = 1e6 / rig.library.manifest.fps
    assert rig.streamer.next_due_us() - due_us <= 2 * period_us + 1, "of a group that was seen, it waits two periods"
    blind = rig.catch_up(rig.streamer.next_due_us())
    assert ends(blind) == [4]
    assert (4, 0) in first_levels(blind)
    late = rig.streamer.finish(job.run(), round(due_us + 2.5 * period_us))
    assert (ends(late), of(TileLayers, late)) == ([], [])


@pytest.mark.parametrize("splats", [40, 400])
def test_a_frame_of_which_much_is_new_is_drawn_ahead(splats: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """One splat changes in a frame: of forty that is much, of four hundred it is not."""
    rig = Rig(FAR, splats=splats, tile_splats=splats // 4)
    rig.play()
    drawn: list[int] = []
    at = rig.library.scenes.at
    monkeypatch.setattr(rig.library.scenes, "at", lambda frame: (drawn.append(frame), at(frame))[1])
    rig.step()
    assert drawn == ([0, 3] if splats == 40 else [0])
    for _ in range(3):
        rig.step()
    assert drawn[-2:] == [3, 6], "another group's splats are all new"


@pytest.mark.parametrize("much", [0.02, 1.0])
def test_births_in_the_frame_ahead_are_seen_however_few(much: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Few of them were seen only when their own frame was drawn: after the mark that its reference assumes."""
    monkeypatch.setattr("cags_server.reference.job.MANY_NEW", much)
    rig = Rig(FAR, served=library(FakeReader(born=1)))
    rig.play()
    assert (BIRTH, 0) in first_levels(rig.step())


@pytest.mark.parametrize("footprint", [PLAIN, "client"])
def test_references_and_mirrors_are_drawn_with_the_footprint_that_is_set(
    footprint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = Rig(replace(SETTINGS, references="difference", reference_footprint=footprint))
    rig.play()
    used: list[Footprint] = []
    render = FakeScene.render

    def noted(scene: FakeScene, camera: Any, options: Any) -> Any:
        used.append(options.footprint)
        return render(scene, camera, options)

    monkeypatch.setattr(FakeScene, "render", noted)
    job = rig.streamer.begin(rig.streamer.next_due_us())
    assert isinstance(job, FrameJob)
    rendered = job.run(iter(range(100)).__next__)
    wanted = Footprint.classic() if footprint == PLAIN else Footprint.of(job.client, job.camera.intrinsics)
    assert used[0] == used[-1] == wanted
    assert wanted != (Footprint.classic() if footprint != PLAIN else None)
    assert len(used) == 3, "the truth, what is new ahead, and the client's render from the reference camera"
    assert (rendered.render_ns, rendered.mirror_ns, rendered.encode_ns) == (1, 1, 1)


@pytest.mark.parametrize("bps", [20_000, 40_000, 80_000])
def test_where_a_difference_comes_too_soon_tiles_come_for_the_display(bps: float) -> None:
    """Once tiles had to be there when they were compared with: over a link that was busy until then none was sent."""
    sent = []
    for references in ("picture", "difference"):
        rig = Rig(replace(FAR, references=references), initial_bps=bps)
        rig.play()
        sent.append([tile for _ in range(3) for tile in first_levels(rig.step())])
    assert sent[0] == sent[1]
    assert len(sent[1]) >= 2
