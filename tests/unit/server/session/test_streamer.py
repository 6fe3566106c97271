"""The per-client core over a scene in memory and a link that this file plays."""

from dataclasses import replace

import pytest

from cags_common.geometry import Pose
from cags_common.tiles.inventory import InventoryEntry
from cags_common.video.h264 import H264Decoder
from cags_protocol import events as ev
from cags_protocol.wire.messages import Blob, FrameEnd, Mark, ReferenceFrame, TileLayers
from cags_server.link import MeasuredLink
from cags_server.link.byte_budget import MESSAGE_OVERHEAD_BYTES
from cags_server.session.streamer import Streamer
from cags_server.settings import ServerSettings
from support.server_scene import CLIENT, FPS, SETTINGS, FakeReader, hello, library
from support.streamer_rig import OFFSET_US, PERIOD_US, Rig, of


def test_the_opening_is_codebooks_then_base_layers_then_the_first_frames_end() -> None:
    opening = Rig().opening
    assert isinstance(opening[0].message, Blob)
    assert opening[0].message.name == "codebooks"
    tiles = of(TileLayers, opening)
    assert {t.tile for t in tiles} == {0, 1, 2, 3}
    assert all((t.frame, t.from_lod, t.to_lod) == (0, 0, 1) for t in tiles)
    assert [e.frame for e in of(FrameEnd, opening)] == [0]


def test_a_first_picture_does_not_wait_for_the_codebooks_of_all_levels(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FakeReader, "base_codebooks", lambda _: b"base")
    away = hello(Pose.looking_at((0, 0, 0), (-3, 0, 3)))
    opening = Streamer(library(), SETTINGS, away, link=MeasuredLink()).startup(0)
    ranked = [each.message for each in sorted(opening, key=lambda each: each.priority)]  # in turn where alike
    names = [message.name if isinstance(message, Blob) else type(message).__name__ for message in ranked]
    assert names[0] == "base-codebooks" and names.count("codebooks") == 1
    end, whole = names.index("FrameEnd"), names.index("codebooks")
    assert set(names[1:end]) == {"TileLayers"}
    assert end < whole < max(i for i, name in enumerate(names) if name == "TileLayers")
    levels = [message.to_lod for message in ranked[:whole] if isinstance(message, TileLayers)]
    assert set(levels) == {1}, "no level above the lowest goes before them"


def test_what_is_out_of_view_comes_after_the_first_frames_end() -> None:
    scene = library()
    away = hello(Pose.looking_at((0, 0, 0), (-3, 0, 3)))
    opening = Streamer(scene, SETTINGS, away, link=MeasuredLink()).startup(0)
    ranked = sorted(range(len(opening)), key=lambda i: (opening[i].priority, i))
    kinds = [type(opening[i].message).__name__ for i in ranked]
    after_end = kinds[kinds.index("FrameEnd") + 1 :]
    assert 0 < len(after_end) < 4
    assert set(after_end) == {"TileLayers"}


def test_joining_within_a_group_brings_the_changes_so_far() -> None:
    streamer = Streamer(library(), SETTINGS, hello(start_frame=9), link=MeasuredLink())
    opening = streamer.startup(0)
    assert [e.frame for e in of(FrameEnd, opening)] == [6, 7, 8, 9]
    assert {t.frame for t in of(TileLayers, opening)} == {6, 7, 8, 9}


def test_nothing_is_planned_before_play() -> None:
    rig = Rig()
    assert rig.streamer.next_due_us() is None
    assert rig.streamer.begin(OFFSET_US + 9_000_000) is None


def test_a_frame_is_a_reference_tiles_and_an_end() -> None:
    rig = Rig()
    rig.play()
    out = rig.step()
    (reference,), (end,) = of(ReferenceFrame, out), of(FrameEnd, out)
    assert (reference.frame, reference.seq, reference.idr) == (0, 2, False), "the greeting came first"
    assert (reference.kind, reference.basis) == ("picture", rig.marks[-1].number)
    assert end.frame == 1, "its tiles are those of the next frame"
    assert reference.intrinsics.fov_rad[0] == pytest.approx(CLIENT.fov_rad[0] * 1.1)
    unit = next(o.payload for o in out if o.message is reference)
    decoder = H264Decoder()
    assert decoder.decode(bytes(rig.greeting[0].payload)) is not None
    assert decoder.decode(bytes(unit)) is not None
    assert of(TileLayers, out)


def test_only_tiles_that_own_visible_splats_are_raised() -> None:
    rig = Rig()
    rig.poses(0, 20_000, pose=Pose.looking_at((0, 0, 0), (-3, 0, 3)))
    rig.control("play")
    assert {t.tile for t in of(TileLayers, rig.step())} < {0, 1, 2, 3}


def test_changed_splats_belong_to_the_tile_of_their_newest_frame() -> None:
    rig = Rig()
    rig.play()
    assert 1 in {t.frame for t in of(TileLayers, rig.step()) if t.from_lod == 0}
    assert 2 in {t.frame for t in of(TileLayers, rig.step()) if t.from_lod == 0}


def test_base_layers_go_before_the_frames_end_and_details_after() -> None:
    rig = Rig()
    rig.play()
    rig.step()
    out = sorted(rig.step(), key=lambda o: o.priority)
    kinds = [(type(o.message).__name__, getattr(o.message, "from_lod", 0) > 0) for o in out]
    end = kinds.index(("FrameEnd", False))
    assert ("TileLayers", True) not in kinds[:end]
    assert ("TileLayers", False) not in kinds[end:]


def test_nothing_held_is_sent_again() -> None:
    rig = Rig()
    rig.play()
    seen: set[tuple[int, int, int]] = set()
    for message in of(TileLayers, rig.opening):
        seen.add((message.frame, message.tile, 0))
    for _ in range(6):
        for message in of(TileLayers, rig.step()):
            for lod in range(message.from_lod, message.to_lod):
                assert (message.frame, message.tile, lod) not in seen
                seen.add((message.frame, message.tile, lod))


def test_dropped_and_evicted_layers_are_sent_again() -> None:
    rig = Rig()
    rig.play()
    first = rig.step(deliver=False)
    rig.drop(first)
    again = rig.step()
    lost = {(m.frame, m.tile) for m in of(TileLayers, first)}
    assert lost <= {(m.frame, m.tile) for m in of(TileLayers, again)}
    rig.streamer.on_event(ev.Evicted((InventoryEntry(0, 1, 1),)), 0)
    assert (0, 1, 1) in {(m.frame, m.tile, m.from_lod) for m in of(TileLayers, rig.step())}


def test_what_is_cancelled_before_it_was_sent_does_not_count_as_sent() -> None:
    """Counted when it was queued, it counted again whenever it was queued again."""
    rig = Rig()
    rig.play()
    stats = rig.streamer.stats

    def sent() -> int:
        return stats.bytes_tiles + stats.bytes_reference + stats.bytes_other

    before = sent()
    assert before == sum(len(each.payload) for each in rig.greeting + rig.opening)
    waiting = rig.step(deliver=False)
    assert sent() == before
    rig.drop(waiting, "cancelled")
    assert sent() == before
    out = rig.step()
    assert sent() == before + sum(len(each.payload) for each in out)


def test_a_tile_that_waited_past_its_display_is_chosen_anew() -> None:
    rig = Rig()
    rig.play()
    opening = [each for each in rig.opening if isinstance(each.message, TileLayers)]
    rig.step()
    waiting = [each for each in rig.step(deliver=False) if isinstance(each.message, TileLayers)]
    assert waiting
    for each in waiting:
        assert each.deadline_us is not None
        displayed_us = each.deadline_us - int(SETTINGS.tile_deadline_ms * 1000)
        assert rig.streamer.outdated(each, displayed_us)
        assert not rig.streamer.outdated(each, displayed_us - 1), "its own frame is still to be displayed"
    assert not any(rig.streamer.outdated(each, 10**12) for each in opening), "a first picture is never taken back"


@pytest.mark.parametrize("marks", [0, 200])
def test_no_more_is_chosen_than_arrives_before_the_display(marks: int) -> None:
    """Marks that arrive leave the account as it was: once each gave back bytes that nothing had taken."""
    late = replace(SETTINGS, tile_deadline_ms=60_000.0)
    rig = Rig(settings=late, initial_bps=64_000)
    rig.play()
    rig.deliver([ev.Outgoing(Mark(number)) for number in range(100, 100 + marks)])
    for _ in range(8):  # nothing is acknowledged: all of it stays on its way
        rig.step(deliver=False)
    records = rig.streamer.stats.records
    on_the_way = sum(record.tile_bytes for record in records)
    dearest = max(max(tile.lod_bytes) for tile in library().entry(0).tiles) + MESSAGE_OVERHEAD_BYTES
    assert on_the_way <= 64_000 * (late.queue_ms + PERIOD_US / 1e3) / 8e3 + dearest
    assert records[-1].tile_bytes == 0


def test_the_budget_is_kept() -> None:
    rig = Rig(initial_bps=200_000)
    rig.play()
    for _ in range(6):
        rig.step()
    income = spent = 0.0
    for record in rig.streamer.stats.records:
        assert record.tile_bytes <= record.budget_bytes
        income += 2 * record.estimate_bps / FPS / 8 * record.ticks_covered  # start-up probes at twice the estimate
        spent += record.tile_bytes
        assert spent <= income, "what is saved was earned"


def test_undelivered_data_takes_from_the_budget() -> None:
    budgets = []
    for delivered in (True, False):
        rig = Rig(ServerSettings(**{**vars(SETTINGS), "queue_ms": 0.0}), initial_bps=2e6)
        rig.play()
        rig.step(deliver=delivered)
        rig.step(deliver=delivered)
        budgets.append(rig.streamer.stats.records[1].budget_bytes)
    assert budgets[1] < budgets[0]


def test_an_idr_follows_a_lost_reference_and_a_request_but_only_once() -> None:
    rig = Rig()
    rig.play()
    rig.step()
    assert [r.idr for r in of(ReferenceFrame, rig.step())] == [False]
    rig.streamer.on_event(ev.KeyframeRequested(1), 0)
    (asked,) = of(ReferenceFrame, rig.step())
    assert asked.idr
    rig.streamer.on_event(ev.KeyframeRequested(asked.seq - 1), 0)  # made before the new IDR arrived
    assert [r.idr for r in of(ReferenceFrame, rig.step())] == [False]
    out = rig.step(deliver=False)
    rig.drop([each for each in out if isinstance(each.message, ReferenceFrame)])
    assert [r.idr for r in of(ReferenceFrame, rig.step())] == [True]


def test_the_end_of_the_media_ends_the_planning_and_a_loop_goes_on() -> None:
    rig = Rig()
    rig.play()
    for _ in range(12):
        rig.step()
    assert rig.streamer.next_due_us() is None
    looped = Rig()
    looped.poses(0)
    looped.control("play", loop=True)
    frames = [of(ReferenceFrame, looped.step())[0].frame for _ in range(14)]
    assert frames == [*range(12), 0, 1]


@pytest.mark.parametrize("keeps", [True, False])
def test_a_client_that_keeps_a_group_is_sent_nothing_again_when_it_loops_or_jumps_in_it(keeps: bool) -> None:
    rig = Rig()
    rig.poses(0)
    rig.control("play", keeps=keeps)
    for _ in range(4):
        rig.step()
    rig.control("seek", 1, 900_000, keeps=keeps)
    again = rig.step()
    assert bool(of(TileLayers, again)) != keeps
    assert of(FrameEnd, again)[-1].frame == 2
    rig.control("seek", 8, 1_900_000, keeps=keeps)  # another group
    assert of(TileLayers, rig.step())
    looped = Rig(gof=12)
    looped.poses(0)
    looped.control("play", loop=True, keeps=keeps)
    for _ in range(12):
        looped.step()
    again = [message for _ in range(12) for message in of(TileLayers, looped.step())]
    assert bool(again) != keeps


def test_a_new_group_starts_from_nothing() -> None:
    rig = Rig()
    rig.play()
    for _ in range(5):
        assert all(tile.frame < 6 for tile in of(TileLayers, rig.step()))
    tiles = of(TileLayers, rig.step())
    assert {(t.frame, t.tile) for t in tiles if t.from_lod == 0} >= {(6, 0), (6, 1), (6, 2), (6, 3)}


def test_a_seek_voids_what_is_being_rendered_and_starts_from_nothing() -> None:
    rig = Rig()
    rig.play()
    job = rig.streamer.begin(rig.streamer.next_due_us())
    rig.control("seek", 8, 400_000)
    assert rig.streamer.finish(job.run(), OFFSET_US) == []
    out = rig.step()
    assert [e.frame for e in of(FrameEnd, out)] == [6, 7, 8, 9]
    assert {t.frame for t in of(TileLayers, out) if t.from_lod == 0} == {6, 7, 8, 9}
    assert of(ReferenceFrame, out)[0].idr


@pytest.mark.parametrize("action", ["pause", "rate"])
@pytest.mark.parametrize("keeps", [True, False])
def test_a_viewer_who_pauses_just_before_another_group_holds_what_was_sent_of_both(action: str, keeps: bool) -> None:
    rig = Rig(replace(SETTINGS, tiles_ahead=3))
    rig.play()
    sent = [tile for _ in range(4) for tile in of(TileLayers, rig.step())]
    assert {tile.frame for tile in sent} >= {5, 6}, "the next group has been entered"
    rig.control(action, 4, 466_667, keeps=keeps)
    again = [tile for _ in range(3) for tile in of(TileLayers, rig.step())]
    rig.control("play", 4, 900_000, keeps=keeps)
    again += [tile for _ in range(5) for tile in of(TileLayers, rig.step())]
    assert not any(mark.restart for mark in rig.marks)
    layers = [(tile.frame, tile.tile, lod) for tile in sent + again for lod in range(tile.from_lod, tile.to_lod)]
    assert len(layers) == len(set(layers)), "nothing is sent twice"


def test_a_jump_beyond_the_clip_goes_to_its_last_frame() -> None:
    rig = Rig()
    rig.play()
    rig.step()
    rig.control("seek", 10**6, 400_000, keeps=True)
    assert of(FrameEnd, rig.step())[-1].frame == 11


def test_a_paused_viewer_still_gets_references_and_detail() -> None:
    rig = Rig()
    rig.play()
    rig.step()
    rig.control("pause", 0, 330_000)
    outs = [rig.step() for _ in range(3)]
    assert [of(ReferenceFrame, out)[0].frame for out in outs] == [0, 0, 0]


def test_the_true_pose_settles_the_record() -> None:
    rig = Rig()
    rig.play()
    rig.step()
    record = rig.streamer.stats.records[0]
    assert record.angular_error_rad is None
    rig.poses(290_000, 310_000, pose=Pose((0.3, 0.0, 0.0), (1, 0, 0, 0)))
    assert record.position_error_m == pytest.approx(0.3)
    assert record.angular_error_rad == pytest.approx(0.0, abs=1e-9)


def test_without_any_pose_the_one_of_the_hello_is_used() -> None:
    rig = Rig()
    rig.control("play", at_us=300_000)
    assert of(ReferenceFrame, rig.step())[0].pose == Pose.identity()


def test_a_reference_only_stream_sends_no_tile() -> None:
    rig = Rig(ServerSettings(**{**vars(SETTINGS), "abr": "none", "opening_tiles": False, "reference_kbps": 100}))
    rig.play()
    sent = rig.opening + [each for _ in range(4) for each in rig.step()]
    assert of(TileLayers, sent) == []
    assert len(of(ReferenceFrame, sent)) == 4
    assert [e.frame for e in of(FrameEnd, sent)] == [0, 1, 2, 3, 4]


def test_after_a_seek_base_layers_come_whatever_the_budget() -> None:
    rig = Rig(initial_bps=65_000)
    rig.play()
    rig.step()
    rig.control("seek", 7, 400_000)
    first, second = rig.step(), rig.step()
    assert {t.tile for t in of(TileLayers, first) if t.frame == 6} == {0, 1, 2, 3}
    assert not [t for t in of(TileLayers, second) if t.frame == 6 and t.from_lod == 0]


def test_unused_budget_is_saved_for_a_tile_larger_than_one_frames_budget() -> None:
    rig = Rig(ServerSettings(**{**vars(SETTINGS), "opening_tiles": False}), initial_bps=64_000)
    rig.play()
    kinds = [bool(of(TileLayers, rig.step())) for _ in range(6)]
    records = rig.streamer.stats.records
    assert any(kinds)
    assert all(record.tile_bytes <= record.budget_bytes for record in records)


def test_tiles_that_are_not_layered_are_sent_whole_and_again_when_better() -> None:
    reader = FakeReader()
    reader.manifest = replace(reader.manifest, codec="video")
    rig = Rig(served=library(reader))
    rig.play()
    sent = [m for _ in range(3) for m in of(TileLayers, rig.step())]
    assert all(message.to_lod == message.from_lod + 1 for message in sent)
    best = {(m.frame, m.tile): 0 for m in of(TileLayers, rig.opening)}
    for message in sent:
        key = message.frame, message.tile
        assert message.from_lod > best.get(key, -1), "only what is better comes again"
        best[key] = message.from_lod
    assert set(best.values()) == {3}
