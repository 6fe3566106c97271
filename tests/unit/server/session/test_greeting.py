"""The first picture of a client that has just joined: before the first tile, and before it has said when to play."""

from __future__ import annotations

from dataclasses import replace

import pytest

from cags_common.geometry import Pose
from cags_common.tiles.inventory import InventoryEntry
from cags_protocol import events as ev
from cags_protocol.wire.messages import Control, ReferenceFrame
from cags_server.link import MeasuredLink
from cags_server.session.streamer import Streamer
from support.server_scene import SETTINGS, FakeReader, hello, library
from support.streamer_rig import OFFSET_US, Rig, of

ASIDE = Pose.looking_at((0, 0, 0), (-3, 0, 3))


def joined(**options: object) -> Streamer:
    """A client that has been sent what opens the stream, and no more."""
    streamer = Streamer(library(), SETTINGS, hello(), link=MeasuredLink(), **options)
    streamer.startup(OFFSET_US)
    return streamer


def test_who_joins_is_greeted_once_with_a_picture_from_where_it_stands() -> None:
    rig = Rig(joins=hello(ASIDE, start_frame=4))
    (greeting,) = of(ReferenceFrame, rig.greeting)
    assert (greeting.frame, greeting.seq, greeting.idr, greeting.kind) == (4, 1, True, "picture")
    assert greeting.pose == ASIDE
    assert rig.marks[0].number == greeting.basis == 1
    assert rig.streamer.next_due_us() is None
    assert rig.streamer.begin(OFFSET_US + 9_000_000) is None
    assert rig.streamer.stats.frames == 0, "it is no frame in its turn"


@pytest.mark.parametrize("references", ["difference", "picture"])
def test_it_is_of_a_kind_that_both_sides_want(references: str) -> None:
    (greeting,) = of(ReferenceFrame, Rig(replace(SETTINGS, references=references)).greeting)
    assert greeting.kind == references


def test_who_comes_back_is_not_greeted() -> None:
    rig = Rig(resumes=(InventoryEntry(0, 1, 2),))
    assert rig.greeting == []
    assert rig.streamer.next_due_us() is None


@pytest.mark.parametrize("where", ["server", "client"])
def test_nobody_is_greeted_where_references_are_not_wanted(where: str) -> None:
    settings = replace(SETTINGS, references="none") if where == "server" else SETTINGS
    rig = Rig(settings, joins=hello() if where == "server" else hello(references="none"))
    assert rig.greeting == []
    assert rig.streamer.next_due_us() is None, "nothing is due for ever"


def test_without_a_place_at_the_renderer_nobody_is_greeted() -> None:
    streamer = joined(may_render=lambda now_us: False)
    tries = 0
    while (due_us := streamer.next_due_us()) is not None:
        assert streamer.begin(due_us) is None
        tries += 1
    assert 1 < tries < 1_000, "nothing is due for ever"


def test_whoever_found_no_place_at_the_renderer_is_greeted_when_there_is_one() -> None:
    """Of several who joined at once, two were greeted and the others saw nothing until their tiles came."""
    free_us = OFFSET_US + 100_000
    streamer = joined(may_render=lambda now_us: now_us >= free_us)
    job = None
    while job is None:
        due_us = streamer.next_due_us()
        assert due_us is not None
        job = streamer.begin(due_us)
    assert job.plan.greets
    assert free_us <= job.plan.planned_us < free_us + 50_000
    assert of(ReferenceFrame, streamer.finish(job.run(), free_us + 50_000))
    assert streamer.next_due_us() is None


def test_a_greeting_that_the_play_has_overtaken_is_void_and_the_next_picture_stands_alone() -> None:
    streamer = joined()
    job = streamer.begin(OFFSET_US)
    assert job is not None
    streamer.on_event(ev.ControlReceived(Control("play", 0, 300_000), OFFSET_US + 10_000), OFFSET_US + 10_000)
    assert streamer.finish(job.run(), OFFSET_US + 20_000) == []
    due_us = streamer.next_due_us()
    assert due_us is not None
    job = streamer.begin(due_us)
    assert job is not None
    (reference,) = of(ReferenceFrame, streamer.finish(job.run(), due_us))
    assert reference.idr


def test_who_plays_before_the_greeting_is_begun_gets_the_first_frame_instead() -> None:
    streamer = joined()
    streamer.on_event(ev.ControlReceived(Control("play", 0, 300_000), OFFSET_US), OFFSET_US)
    streamer.begin(OFFSET_US)
    due_us = streamer.next_due_us()
    assert due_us is not None
    job = streamer.begin(due_us)
    assert job is not None
    assert not job.plan.greets


def test_a_greeting_says_nothing_of_where_the_viewer_will_be() -> None:
    """It put the Hello's pose into the history at a time by a clock that was not known yet, in the viewer's future."""
    rig = Rig()
    rig.poses(0, 20_000, 40_000, pose=ASIDE)
    rig.control("play")
    (reference,) = of(ReferenceFrame, rig.step())
    assert reference.pose.rotation == pytest.approx(ASIDE.rotation, abs=1e-6)


def test_a_black_scene_is_greeted_with_nothing() -> None:
    away = Pose.looking_at((0, 0, 0), (0, 0, -3), (0, -1, 0))
    rig = Rig(joins=hello(away), served=library(FakeReader()))
    (greeting,) = of(ReferenceFrame, rig.greeting)
    assert (greeting.kind, greeting.seq, rig.greeting[0].payload) == ("nothing", 0, b"")
