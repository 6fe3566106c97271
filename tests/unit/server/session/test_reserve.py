"""The reserve of frames: it grows over an idle link, is used up over a slow one, and keeps to one group of frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_common.bundle.manifest import MotionSteps
from cags_common.geometry import Pose
from cags_common.splats import Ids
from cags_protocol import events as ev
from cags_protocol.wire.messages import FrameEnd, ReferenceFrame, TileLayers
from cags_server.ratecontrol.outlook import Supply
from cags_server.session import tile_planner
from cags_server.session.reserve import Reserve
from support.server_scene import SETTINGS, FakeReader, hello, library
from support.streamer_rig import OFFSET_US, Rig, of

LEAST = 2
RESERVED = replace(SETTINGS, tiles_ahead=LEAST, reserve_s=0.4)
"""A fast link carries every tile of the wall at once."""

BEHIND = Pose.looking_at((0, 0, 0), (0, 0, -3), (0, -1, 0))


class OneSplat(FakeReader):
    """The same splat changes in every frame."""

    def tile_ids(self, frame: int, tile: int) -> Ids:
        return super().tile_ids(frame, tile) if frame == 0 else np.zeros(1, np.int32)


def ends(outgoing: list[ev.Outgoing]) -> list[int]:
    return [end.frame for end in of(FrameEnd, outgoing)]


def test_it_grows_only_while_the_client_has_everything() -> None:
    reserve = Reserve(2, 1.0)
    for supply, frames in [
        (Supply.COMPLETE, 3),
        (Supply.DETAIL_MISSING, 3),
        (Supply.COMPLETE, 4),
        (Supply.BASE_MISSING, 3),
        (Supply.BASE_MISSING, 2),
        (Supply.BASE_MISSING, 2),
    ]:
        reserve.planned(supply, period_us=1e6 / 30)
        assert (reserve.frames, reserve.grown) == (frames, frames > 2)


@given(
    st.lists(st.tuples(st.sampled_from(Supply), st.sampled_from([1e6 / 60, 1e6 / 30, 1e6 / 3]))),
    st.integers(1, 30),
    st.floats(0, 5),
)
def test_it_lies_between_its_bounds(plans: list[tuple[Supply, float]], least: int, longest_s: float) -> None:
    reserve, longest = Reserve(least, longest_s), 1e6 / 60
    for supply, period_us in plans:
        reserve.planned(supply, period_us=period_us)
        assert least <= reserve.frames <= max(least, longest_s * 1e6 / longest)
        reserve.reach_on(period_us)
        assert least <= reserve.frames <= max(least, longest_s * 1e6 / longest)
    reserve.restart()
    assert reserve.frames == least


def test_over_an_idle_link_each_frame_ends_earlier_than_the_one_before() -> None:
    rig = Rig(RESERVED, frames=60, gof=60)
    rig.play()
    sent = list(rig.opening)
    leads = []
    for frame in range(40):
        out = rig.step()
        assert [reference.frame for reference in of(ReferenceFrame, out)] == [frame]
        leads.append(rig.streamer.stats.records[-1].ahead.frame - frame)
        sent += out
    assert leads[0] == LEAST
    assert max(leads) == 12, "0.4 seconds"
    assert leads == sorted(leads)
    ended = ends(sent)
    assert ended == list(range(ended[-1] + 1)), "each once, and in order"


def test_over_a_path_of_long_delay_it_reaches_what_can_still_arrive(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a round trip of a second 89 of 90 frames were late over an idle link: no first level of a frame could come
    in time, and for want of them the frames after it were not looked at.
    """
    monkeypatch.setattr(tile_planner, "supply", lambda *_: Supply.DETAIL_MISSING)
    rig = Rig(replace(RESERVED, reserve_s=1.0), frames=60, gof=60)
    rig.play()
    rtt_us, leads = 800_000, []
    for _ in range(30):
        rig.streamer._link.on_ack(replace(rig.streamer._link.newest, rtt_us=rtt_us, shortest_rtt_us=rtt_us))
        rig.step()
        record = rig.streamer.stats.records[-1]
        leads.append(record.ahead.display_us + OFFSET_US - record.planned_us)
    assert leads[0] < rtt_us < leads[-1]


def test_a_seek_begins_without_a_reserve() -> None:
    rig = Rig(RESERVED, frames=60, gof=60)
    rig.play()
    for _ in range(10):
        rig.step()
    assert rig.streamer.stats.records[-1].ahead.frame - 9 > LEAST
    rig.control("seek", 30, 900_000)
    rig.step()
    record = rig.streamer.stats.records[-1]
    assert (record.frame, record.ahead.frame) == (30, 30 + LEAST)


def test_it_ends_before_the_next_group_of_frames_which_is_entered_as_without_it() -> None:
    rig = Rig(RESERVED, frames=60, gof=20)
    rig.play()
    for frame in range(60):
        rig.step()
        record = rig.streamer.stats.records[-1]
        ahead = min(record.ahead.frame, 59)
        assert ahead // 20 == frame // 20 or ahead - frame <= LEAST, (frame, ahead)


def test_what_comes_into_view_is_sent_for_frames_that_were_planned_already() -> None:
    """They were planned while the viewer looked away, and of their changes nothing is left in the newest frame."""
    settings = replace(RESERVED, opening_tiles=False, predictor="hold")
    rig = Rig(settings, joins=hello(BEHIND), served=library(OneSplat(frames=60, gof=60)))
    rig.poses(0, 20_000, pose=BEHIND)
    rig.control("play")
    for _ in range(11):
        assert of(TileLayers, rig.step()) == []
    seen_us = rig.now_us - OFFSET_US
    rig.poses(seen_us, seen_us + 1000)
    sent = rig.step() + rig.step()
    record = rig.streamer.stats.records[-1]
    near, ahead = record.frame + LEAST, record.ahead.frame
    assert ahead > near + LEAST
    brought = {tile.frame for tile in of(TileLayers, sent) if tile.from_lod == 0}
    assert brought & {near - 1, near}, "of the frames that are displayed first"
    assert ahead in brought, "and of the one that the reserve has reached"


def test_it_is_bounded_by_the_splats_that_a_client_would_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    """One splat of the wall changes in every frame."""
    monkeypatch.setattr(tile_planner, "RESERVED_SPLATS", 8)
    rig = Rig(RESERVED, frames=60, gof=60)
    rig.play()
    leads = []
    for frame in range(30):
        rig.step()
        leads.append(rig.streamer.stats.records[-1].ahead.frame - frame)
    assert max(leads) == 7


def test_every_frame_is_planned_while_it_grows() -> None:
    """Of a frame that was passed over, attributes that the next one changes again were never sent."""
    reader = OneSplat(frames=60, gof=60)
    reader.manifest = replace(reader.manifest, motion=MotionSteps((0.1,), (0.1,)))
    rig = Rig(RESERVED, served=library(reader))
    rig.play()
    sent = list(rig.opening)
    for _ in range(40):
        sent += rig.step()
    ahead = rig.streamer.stats.records[-1].ahead.frame
    assert ahead > 39 + LEAST
    brought = {tile.frame for tile in of(TileLayers, sent)}
    assert brought >= set(range(LEAST, ahead + 1))


def test_what_a_plan_looks_at_is_known_before() -> None:
    """It is read from the store in time: the frames that are passed over, too."""
    rig = Rig(RESERVED, frames=60, gof=60)
    rig.play()
    reached = 0
    for _ in range(30):
        known = rig.streamer.next_frames
        rig.step()
        record = rig.streamer.stats.records[-1]
        passed = range(reached + 1, record.ahead.frame)
        assert known == (*passed, record.ahead.frame)
        reached = record.ahead.frame


def key_tiles(outgoing: list[ev.Outgoing], frame: int) -> set[tuple[int, int]]:
    """Tiles of ``frame`` and their levels."""
    tiles = [tile for tile in of(TileLayers, outgoing) if tile.frame == frame]
    return {(tile.tile, lod) for tile in tiles for lod in range(tile.from_lod, tile.to_lod)}


def test_over_an_idle_link_the_next_group_comes_before_its_first_frame_is_due() -> None:
    """All its splats were due at once: after each border quality fell by twenty decibels for a second."""
    rig = Rig(RESERVED, frames=60, gof=20)
    rig.play()
    sent: dict[int, set[tuple[int, int]]] = {}
    for frame in range(18):
        out = rig.step()
        record = rig.streamer.stats.records[-1]
        assert not ends(out) or ends(out)[-1] == record.ahead.frame, "none of the next group yet"
        if record.ahead.frame < 20:
            sent[frame] = key_tiles(out, 20)
            assert all(each.deadline_us for each in out if isinstance(each.message, TileLayers))
    assert [frame for frame, tiles in sent.items() if tiles] == [8], "0.4 seconds before"
    assert sent[8] == {(tile, lod) for tile in range(4) for lod in range(4)}
    later = rig.step() + rig.step() + rig.step()
    assert ends(later)[-1] >= 20
    assert not key_tiles(later, 20), "once"


@pytest.mark.parametrize("why", ["no reserve", "many splats", "lacks", "not read"])
def test_the_next_group_waits_for_its_turn(why: str, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = replace(RESERVED, reserve_s=0.0) if why == "no reserve" else RESERVED
    if why == "many splats":
        monkeypatch.setattr(tile_planner, "RESERVED_SPLATS", 30)
    if why == "lacks":
        monkeypatch.setattr(tile_planner, "supply", lambda *_: Supply.DETAIL_MISSING)
    rig = Rig(settings, frames=60, gof=20)
    if why == "not read":
        monkeypatch.setattr(rig.streamer._planner, "_fetches", True)
        monkeypatch.setattr(rig.library, "at_hand", lambda frame: frame < 20)
    rig.play()
    for frame in range(17):
        out = rig.step()
        if rig.streamer.stats.records[-1].ahead.frame < 20:
            assert not key_tiles(out, 20)
            assert rig.streamer.next_opening == (20 if why == "not read" and frame >= 8 else None)
    rig.control("pause", 17, 900_000, keeps=True)
    rig.step()
    assert rig.streamer.next_opening is None


@pytest.mark.parametrize("loop", [True, False])
def test_in_a_loop_the_last_group_is_followed_by_the_first(loop: bool) -> None:
    rig = Rig(RESERVED, frames=40, gof=20)
    rig.control("play", 20, 300_000, loop=loop, keeps=True)
    out = [each for _ in range(30 if loop else 19) for each in rig.step()]
    first = [n for n, each in enumerate(out) if isinstance(each.message, TileLayers) and each.message.frame == 0]
    assert bool(first) is loop
    if loop:
        end = next(n for n, each in enumerate(out) if isinstance(each.message, FrameEnd) and each.message.frame == 0)
        assert first[-1] < end, "all of them before it is due"


def test_a_loop_of_a_clip_that_is_kept_whole_brings_nothing_twice() -> None:
    rig = Rig(RESERVED, frames=40, gof=20)
    rig.control("play", 0, 300_000, loop=True, keeps=True)
    sent = [each for _ in range(100) for each in rig.step()]
    tiles = [(tile.frame, tile.tile, lod) for tile in of(TileLayers, sent) for lod in range(tile.from_lod, tile.to_lod)]
    assert len(tiles) == len(set(tiles))
    assert {frame for frame, *_ in tiles} >= {0, 20}
    assert not any(mark.restart for mark in rig.marks)
