"""What tells a client which of what it was sent a reference assumes."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest

from cags_common.tiles.inventory import InventoryEntry
from cags_protocol import events as ev
from cags_protocol.wire.messages import FrameEnd, Mark, ReferenceFrame, TileLayers
from cags_server.reference.lateness import PATIENCE
from cags_server.session.streamer import MARK_EVERY_US
from support.server_scene import SETTINGS, FakeReader, hello, library
from support.streamer_rig import Rig, of

DIFFERENCES = replace(SETTINGS, references="difference")


def test_a_reference_assumes_what_was_written_before_it_was_begun() -> None:
    rig = Rig()
    rig.play()
    for _ in range(12):
        rig.now_us = rig.streamer.next_due_us()
        job = rig.streamer.begin(rig.now_us)
        newest = rig.take_marks()[-1]
        assert job.plan.basis == newest.number
        out = rig.streamer.finish(job.run(), rig.now_us + 20_000)
        assert of(ReferenceFrame, out)[0].basis == newest.number
        rig.deliver(out)
    assert [mark.number for mark in rig.marks] == list(range(1, len(rig.marks) + 1))
    assert not any(mark.restart for mark in rig.marks)


def test_while_tiles_are_written_there_is_a_mark_every_thirtieth_of_a_second() -> None:
    rig = Rig()
    rig.play()
    out = [each for each in rig.step(deliver=False) if isinstance(each.message, TileLayers | FrameEnd)]
    assert len(out) >= 4
    rig.now_us += MARK_EVERY_US
    first, began_us = len(rig.marks), rig.now_us
    for number in range(31):
        rig.now_us = began_us + 10_000 * number
        rig.send(out[number % len(out) :][:1])
    assert len(rig.marks) - first == 31 * 10_000 // MARK_EVERY_US + 1
    rig.send(out[:1])
    due_us = rig.streamer.mark_due_us
    assert due_us == rig.now_us + MARK_EVERY_US
    rig.streamer.mark_if_due(due_us - 1)
    assert rig.take_marks() == []
    rig.streamer.mark_if_due(due_us)
    assert len(rig.take_marks()) == 1
    first += 1
    rig.now_us += 10 * MARK_EVERY_US
    assert rig.streamer.mark_due_us is None, "nothing was sent"
    rig.streamer.mark_if_due(rig.now_us)
    assert rig.take_marks() == []
    reference = ev.Outgoing(of(ReferenceFrame, rig.greeting)[0])
    rig.send([reference])
    assert len(rig.marks) - first == 31 * 10_000 // MARK_EVERY_US + 1, "only what is shown by marks asks for them"


@pytest.mark.parametrize("where", ["server", "client"])
def test_there_are_none_where_references_are_not_wanted(where: str) -> None:
    settings = replace(SETTINGS, references="none") if where == "server" else SETTINGS
    rig = Rig(settings, joins=hello() if where == "server" else hello(references="none"))
    rig.play()
    for _ in range(4):
        assert of(ReferenceFrame, rig.step()) == []
        rig.now_us += 2 * MARK_EVERY_US
    assert rig.marks == []
    assert rig.streamer.stats.bytes_tiles > 0


def test_a_mirror_that_nobody_draws_is_told_nothing() -> None:
    """What was written would have waited in it for a reference that never comes, without a bound."""
    for changes in ({"references": "picture"}, {"references": "none"}):
        rig = Rig(replace(SETTINGS, **changes))
        rig.play()
        rig.step()
        assert not rig.streamer._mirror._log


@pytest.mark.parametrize("keeps", [True, False])
def test_a_jump_is_answered_by_a_restart_where_the_client_forgets(keeps: bool) -> None:
    rig = Rig(DIFFERENCES)
    rig.play()
    rig.step()
    rig.step()
    before = len(rig.marks)
    rig.control("seek", 1, 900_000, keeps=keeps)
    assert [mark.restart for mark in rig.marks[before:]] == ([] if keeps else [True])
    due_us = rig.now_us = rig.streamer.next_due_us()
    job = rig.streamer.begin(due_us)
    assert (job.mirror.scene_at(1, job.plan.basis) is not None) == keeps
    rig.deliver(rig.streamer.finish(job.run(), due_us))
    rig.step()
    mirrored = rig.streamer._mirror.splats
    assert mirrored is not None, "what came since is mirrored"
    assert sum(mark.restart for mark in rig.marks) == (not keeps)


def test_a_jump_to_another_group_is_answered_by_a_restart_whatever_the_client_keeps(groups_pass: None) -> None:
    rig = Rig()
    rig.play()
    rig.step()
    rig.control("seek", 9, 900_000, keeps=True)
    assert rig.marks[-1].restart


@pytest.mark.parametrize("keeps", [False, True])
def test_a_jump_within_a_clip_that_is_kept_whole_is_answered_by_a_restart_where_the_client_asks(keeps: bool) -> None:
    rig = Rig()
    rig.play()
    rig.step()
    rig.control("seek", 9, 900_000, keeps=keeps)
    assert any(mark.restart for mark in rig.marks) is not keeps


def test_a_restart_goes_before_what_follows_the_jump() -> None:
    rig = Rig()
    rig.play()
    rig.step()
    rig.control("seek", 8, 900_000)
    restart = rig.marks[-1]
    assert restart.restart
    (reference,) = of(ReferenceFrame, rig.step())
    assert reference.basis > restart.number


@pytest.mark.parametrize(("reason", "restarts"), [("lost", True), ("stale", False), ("cancelled", False)])
def test_what_was_written_and_did_not_arrive_makes_the_client_begin_anew(reason: str, restarts: bool) -> None:
    rig = Rig(DIFFERENCES)
    rig.play()
    out = rig.step(deliver=False)
    tile = next(each for each in out if isinstance(each.message, TileLayers))
    rig.send([each for each in out if restarts or each is not tile])
    rig.drop([tile], reason)
    before = len(rig.marks)
    job_at = rig.now_us = rig.streamer.next_due_us()
    job = rig.streamer.begin(job_at)
    marks = rig.take_marks()
    assert [mark.restart for mark in marks] == ([True, False] if restarts else [False])
    assert job.plan.basis == marks[-1].number == before + len(marks)
    again = rig.streamer.finish(job.run(), job_at)
    fresh = {(m.frame, m.tile) for m in of(TileLayers, again) if m.from_lod == 0}
    assert (fresh >= {(0, tile) for tile in range(4)}) == restarts
    first = 0 if restarts else 2
    assert [end.frame for end in of(FrameEnd, again)] == list(range(first, 3))
    rig.deliver(again)
    rig.step()
    assert sum(mark.restart for mark in rig.marks) == restarts, "once"


def test_a_client_that_holds_the_truth_is_told_so_in_a_few_bytes() -> None:
    rig = Rig(served=library(FakeReader(lossy=False)))
    rig.play()
    (silent,) = [each for each in rig.step() if isinstance(each.message, ReferenceFrame)]
    message = silent.message
    assert (message.kind, message.seq, message.idr, silent.payload) == ("nothing", 1, False, b"")
    assert message.basis == rig.marks[-1].number, "it says what is held by then"
    record = rig.streamer.stats.records[-1]
    assert (record.reference_kind, record.reference_bytes, record.lacking) == ("nothing", 0, 0.0)
    rig.drop([silent])
    assert not rig.streamer._video.needs_idr, "no picture was lost"


def test_what_a_client_brings_back_is_mirrored() -> None:
    held = tuple(InventoryEntry(0, tile, 4) for tile in range(4))
    rig = Rig(DIFFERENCES, resumes=held)
    assert of(TileLayers, rig.opening) == [], "nothing that it holds is sent"
    fresh = Rig(DIFFERENCES)
    for each in (rig, fresh):
        each.play()
        for _ in range(3):
            each.step()
    brought, sent = rig.streamer._mirror.splats, fresh.streamer._mirror.splats
    assert brought is not None and sent is not None
    for (name, mine), (_, theirs) in zip(brought.arrays(), sent.arrays(), strict=True):
        assert (mine == theirs).all(), name


def test_marks_are_made_in_the_order_in_which_they_are_to_be_written() -> None:
    rig = Rig()
    rig.play()
    for _ in range(5):
        rig.step()
        rig.now_us += MARK_EVERY_US
        rig.send([each for each in rig.opening if isinstance(each.message, TileLayers)][:1])
    assert all(isinstance(mark, Mark) for mark in rig.marks)
    assert all(b.number == a.number + 1 for a, b in pairwise(rig.marks))


def test_the_mirror_knows_what_was_sent_while_references_came_late_and_nothing_was_compared() -> None:
    """Comparing then began again with a mirror that lacked it, and differences spoilt pictures that were right."""
    rig = Rig(replace(SETTINGS, references="auto"))
    rig.play()
    coder, mirror = rig.streamer._coder, rig.streamer._mirror
    for _ in range(10):
        coder.lateness.observe(late=True)
    assert not coder.compares
    for _ in range(5):
        rig.step()
    for _ in range(PATIENCE):
        coder.lateness.observe(late=False)
    assert coder.compares
    assert mirror.scene_at(5, mirror.mark()) is not None
    assert mirror.splats is not None
    held = {key: rig.streamer._tiles.inventory.depth(*key) for key in ((0, 0), (0, 1), (5, 0))}
    assert {key: depth for key, depth in held.items() if not depth} == {}
    store = mirror._store.on_display
    assert store is not None
    assert {(tile.frame, tile.tile): tile.lods for tile in store.held()}.items() >= held.items()
