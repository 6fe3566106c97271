"""The player in time, without sockets, clocks or threads: messages in, messages and work out."""

from __future__ import annotations

import random

import numpy as np
import pytest

from cags_client.frame.pipeline import ClientPipeline
from cags_client.playback.jobs import Decode
from cags_client.playback.player import Player
from cags_client.playback.startup import QUIET_US
from cags_client.settings import ClientSettings
from cags_client.stats import MAX_NOTICES
from cags_common.coding.packing import encode_ids
from cags_common.errors import DecodeError, NetworkError
from cags_common.geometry import Pose
from cags_protocol import ClientSession, ServerSession
from cags_protocol import events as ev
from cags_protocol.sessions.blobs import BASE_CODEBOOKS_BLOB, CODEBOOKS_BLOB, WEIGHTS_BLOB
from cags_protocol.wire.encoding import encode
from cags_protocol.wire.messages import (
    Blob,
    Bye,
    Control,
    FrameEnd,
    Hello,
    Mark,
    Notice,
    ReferenceFrame,
    Refusal,
    RefusalCode,
    TileLayers,
    Welcome,
)
from support.small_store import base, books, manifest
from support.wire_pair import tile


class Still:
    """A viewer who does not move."""

    def pose_at(self, t_us: int) -> Pose:
        return Pose.identity()


def player(*, others: int = 0, **changes: object) -> Player:
    settings = ClientSettings(**{"width": 16, "height": 12, "reconnect_s": 5.0, "startup_ms": 0, **changes})  # type: ignore[arg-type]
    return Player(ClientSession(now_us=0), settings, Still(), now_us=0, rng=random.Random(1), others=others)


def welcome(**changes: object) -> bytes:
    info = manifest(**changes).to_json()  # type: ignore[arg-type]
    return encode(Welcome("s", 30.0, 8, False, info))


def sent(client: Player, server: ServerSession, now_us: int) -> list[object]:
    """What the server hears of that which the client writes now."""
    for data in client.data_to_send(now_us):
        server.receive(data, now_us=now_us)
    heard = []
    while (event := server.next_event()) is not None:
        heard.append(event)
    return heard


def joined(client: Player) -> ServerSession:
    """The server of a client that has its codebooks."""
    server = ServerSession(now_us=0)
    sent(client, server, 0)
    server.accept(Welcome("s", 30.0, 8, False, manifest().to_json()), now_us=0)
    codebooks = books().to_bytes()
    server.queue(ev.Outgoing(Blob(CODEBOOKS_BLOB, 0, len(codebooks)), codebooks), now_us=0)
    for data in server.data_to_send(0):
        client.receive(data, 0)
    return server


def first_frame_comes(client: Player, server: ServerSession, now_us: int) -> None:
    """The first frame is there whole, and decoded: with no startup buffer the play begins."""
    server.queue(ev.Outgoing(FrameEnd(0), encode_ids(np.zeros(0, np.int32))), now_us=now_us)
    for data in server.data_to_send(now_us):
        client.receive(data, now_us)
    while isinstance(action := client.next_action(now_us), Decode):
        client.done(action, action.run(), now_us)
    client.handle_timer(now_us)


def test_a_first_frame_is_shown_before_the_codebooks_of_all_levels_have_come() -> None:
    client, server = player(), ServerSession(now_us=0)
    sent(client, server, 0)
    server.accept(Welcome("s", 30.0, 8, False, manifest().to_json()), now_us=0)
    data = books().base.to_bytes()
    server.queue(ev.Outgoing(Blob(BASE_CODEBOOKS_BLOB, 0, len(data)), data), now_us=0)
    first = base([0, 1, 2], 0)
    server.queue(ev.Outgoing(TileLayers(0, 0, 0, 1, (len(first),)), bytes(first)), now_us=0)
    first_frame_comes(client, server, 300_000)
    assert client._presenting, "a picture while more arrives"
    assert client.stats.started_us is None and client.stats.decode_errors == 0, "but no play before it can be refined"
    assert [(held.frame, held.tile, held.lods) for held in client.pipeline.held()] == [(0, 0, 1)]
    assert not client._hello(0, Pose.identity()).resume, "a server would leave the codebooks out"
    whole = books().to_bytes()
    server.queue(ev.Outgoing(Blob(CODEBOOKS_BLOB, 0, len(whole)), whole), now_us=310_000)
    for packet in server.data_to_send(310_000):
        client.receive(packet, 310_000)
    assert client._hello(0, Pose.identity()).resume == "s" and not client.finished
    client.handle_timer(310_000)
    assert client.stats.started_us is not None


def test_parts_of_a_tile_that_a_slow_link_takes_long_for_keep_the_first_frame_on_hold() -> None:
    client = player(startup_ms=10_000)
    server = joined(client)
    server.rate_hint_bps = 1e9
    first_frame_comes(client, server, 100_000)
    server.queue(tile(0, 1, 50_000), now_us=100_000)
    now_us = 100_000
    packets = server.data_to_send(now_us)
    assert len(packets) > 5
    for packet in packets[:-1]:
        now_us += QUIET_US * 9 // 10
        client.receive(packet, now_us)
        client.handle_timer(now_us)
    assert client.stats.started_us is None, "a part of a tile was taken for silence"
    client.handle_timer(now_us + QUIET_US)
    assert client.stats.started_us is not None


def test_what_was_drawn_for_a_client_without_splats_is_forgotten_when_the_clip_plays() -> None:
    client = player(startup_ms=700)
    server = joined(client)
    nothing = ReferenceFrame(0, 0, Pose.identity(), client.settings.intrinsics, False, "nothing")
    server.queue(ev.Outgoing(nothing), now_us=0)
    first_frame_comes(client, server, 100_000)
    assert client.pipeline is not None
    references = client.pipeline._references
    references.show(0, 8)
    assert references.newest(0) is not None
    later = ReferenceFrame(1, 0, Pose.identity(), client.settings.intrinsics, False, "nothing")
    server.queue(ev.Outgoing(later), now_us=150_000)
    for data in server.data_to_send(150_000):
        client.receive(data, 150_000)
    while isinstance(action := client.next_action(150_000), Decode):
        client.done(action, action.run(), 150_000)
    client.handle_timer(100_000 + QUIET_US)
    assert client.stats.started_us is not None
    references.show(0, 8)
    assert references.newest(0) is None
    references.show(1, 8)
    assert references.newest(0) is not None, "it came after the first frame was whole"


def test_the_first_thing_that_is_sent_is_a_hello_with_the_viewers_camera() -> None:
    (hello,) = [e.hello for e in sent(player(), ServerSession(now_us=0), 0) if isinstance(e, ev.Joined)]
    assert isinstance(hello, Hello)
    assert (hello.intrinsics.width_px, hello.intrinsics.height_px) == (16, 12)
    assert hello.pose == Pose.identity()


def test_nothing_is_to_be_done_before_the_server_has_answered() -> None:
    client = player()
    assert client.next_action(10_000_000) is None
    assert not client.finished


def test_no_first_frame_in_time_ends_the_play_and_says_so() -> None:
    client = player(join_timeout=2.0)
    client.handle_timer(1_900_000)
    assert client.error is None
    client.handle_timer(2_100_000)
    assert client.finished
    assert client.next_timer_us() is None
    assert isinstance(client.error, NetworkError)
    assert "no first frame within 2 s" in str(client.error)


@pytest.mark.parametrize("code", [RefusalCode.TOKEN, RefusalCode.VERSION])
def test_a_refusal_that_another_attempt_would_meet_again_ends_the_play(code: RefusalCode) -> None:
    client = player()
    client.receive(encode(Refusal(code.value, "token", "who are you")), 1)
    assert client.finished
    assert "the server refused (token): who are you" in str(client.error)


def test_a_stream_that_takes_more_memory_than_the_viewer_gives_ends_the_play() -> None:
    client = player(max_splats=5)
    client.receive(welcome(), 1)
    assert client.finished
    assert "--max-splats" in str(client.error)


def test_a_group_of_frames_that_comes_makes_work_and_only_one_piece_at_a_time() -> None:
    client = player()
    joined(client)
    assert client.pipeline is not None
    client._take(ev.MarkReceived(Mark(1)))
    first = client.next_action(0)
    assert isinstance(first, Decode)
    assert client.next_action(0) is None, "decoding goes on one piece after another"
    client.done(first, first.run(), 0)
    assert client.next_action(0) is None


def test_play_is_asked_for_once_and_begins_after_the_delay() -> None:
    client = player(start_delay_ms=300)
    server = joined(client)
    sent(client, server, 0)
    first_frame_comes(client, server, 1_000_000)
    first_frame_comes(client, server, 1_200_000)
    asked = [e.control for e in sent(client, server, 1_200_000) if isinstance(e, ev.ControlReceived)]
    assert asked == [Control("play", 0, 1_300_000)]
    assert client.next_action(1_299_999) is None
    action = client.next_action(1_300_000)
    assert action is not None
    assert action.frame == 0  # type: ignore[union-attr]


def test_frames_that_are_late_are_dropped_where_asked_for() -> None:
    client = player(start_delay_ms=10, drop_late=True)
    first_frame_comes(client, joined(client), 0)
    action = client.next_action(110_000)
    assert action is not None
    assert action.frame == 3  # type: ignore[union-attr]
    assert client.stats.dropped == 3


def test_a_connection_that_is_lost_after_the_welcome_is_opened_again_and_tells_where_the_play_stands() -> None:
    client = player(start_delay_ms=10)
    first_frame_comes(client, joined(client), 0)
    client.lost("reset", 500_000)
    assert client.away
    assert not client.finished
    assert client.wants_connection(5_000_000)
    client.connected(5_000_000)
    again = ServerSession(now_us=5_000_000)
    (hello,) = [e.hello for e in sent(client, again, 5_000_000) if isinstance(e, ev.Joined)]
    assert hello.resume == "s"


def test_a_connection_that_does_not_come_back_in_time_ends_the_play() -> None:
    client = player(reconnect_s=1.0)
    joined(client)
    client.lost("reset", 0)
    client.handle_timer(1_500_000)
    assert client.finished
    assert "the connection was lost (reset)" in str(client.error)
    assert (client.stats.reconnects, client.stats.away_us) == (0, 1_500_000)
    client.handle_timer(2_000_000)
    client.leave(2_000_000)
    assert client.stats.away_us == 1_500_000, "counted once"


def test_a_viewer_who_leaves_while_the_connection_is_away_was_away_until_then() -> None:
    client = player()
    joined(client)
    client.lost("reset", 400_000)
    client.leave(1_000_000)
    assert client.stats.away_us == 600_000


def test_before_the_welcome_a_lost_connection_is_the_end() -> None:
    client = player()
    client.lost("refused", 0)
    assert client.finished
    assert isinstance(client.error, NetworkError)


@pytest.mark.parametrize("code", [RefusalCode.FULL, RefusalCode.INTERNAL, RefusalCode.TIMEOUT])
def test_a_server_without_room_is_skipped_while_there_are_others(code: RefusalCode) -> None:
    client = player(others=1, reconnect_s=0.0)
    client.receive(encode(Refusal(code.value, "", "try again later")), 1)
    assert not client.finished
    assert client.wants_connection(1)
    assert client.attempts == 0, "it goes to another server, not to the same one again"
    client.connected(2)
    server = joined(client)
    assert not client.away
    assert client.stats.reconnects == 0, "nothing was lost"
    assert client.info is not None
    client.lost("reset", 3)
    assert client.finished, "reconnect_s = 0 counts from the first session on"
    assert not server.closed


@pytest.mark.parametrize("end", ["full", "bye", "lost"])
def test_a_single_server_without_room_ends_the_play_at_once_with_its_reason(end: str) -> None:
    client = player()
    if end == "lost":
        client.lost("reset", 1)
    else:
        client.receive(encode(Refusal("full", "", "it is full") if end == "full" else Bye("it is full")), 1)
    assert client.finished
    assert ("reset" if end == "lost" else "it is full") in str(client.error)


def test_when_no_other_server_can_be_reached_the_reason_of_the_one_that_answered_is_given() -> None:
    client = player(others=2)
    client.receive(encode(Refusal("full", "", "it is full")), 1)
    for now_us in (2, 3):
        assert not client.finished
        assert client.wants_connection(now_us)
        client.lost("connection refused", now_us)
    assert client.finished
    assert "it is full" in str(client.error)


def test_a_server_that_comes_back_with_another_scene_ends_the_play() -> None:
    client = player()
    joined(client)
    client.lost("reset", 0)
    assert client.wants_connection(5_000_000) or client.wants_connection(10_000_000)
    client.connected(10_000_000)
    client.receive(welcome(frames=9), 10_000_000)
    assert client.finished
    assert "another scene" in str(client.error)


def test_leaving_says_goodbye() -> None:
    client = player()
    server = joined(client)
    sent(client, server, 0)
    client.leave(1)
    assert client.finished
    assert client.error is None
    closed = [e for e in sent(client, server, 1) if isinstance(e, ev.Closed)]
    assert [e.code for e in closed] == ["bye"]


def test_what_the_server_has_to_say_is_told_once(caplog: pytest.LogCaptureFixture) -> None:
    client = player()
    joined(client)
    for text in ("the link is slow", "the link is slow", "the store is slow"):
        client.receive(encode(Notice("slow", text)), 0)
    told = ["the server says: the link is slow (slow)", "the server says: the store is slow (slow)"]
    assert list(client.stats.notices) == told
    assert [record.getMessage() for record in caplog.records] == told
    assert {record.levelname for record in caplog.records} == {"WARNING"}


def test_a_server_that_talks_without_end_is_neither_remembered_nor_repeated(caplog: pytest.LogCaptureFixture) -> None:
    client = player()
    joined(client)
    for number in range(2000):
        client.receive(encode(Notice("slow", f"{number}")), 0)
    assert len(client.stats.notices) == MAX_NOTICES
    assert client.stats.notices[-1] == "the server says: 1999 (slow)"
    assert len(caplog.records) < 2 * MAX_NOTICES


def test_why_the_scenes_own_weights_are_not_used_is_told(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def damaged(pipeline: ClientPipeline, data: bytes) -> None:
        raise DecodeError("weights: are damaged")

    monkeypatch.setattr(ClientPipeline, "on_weights", damaged)
    client = player()
    server = joined(client)
    server.queue(ev.Outgoing(Blob(WEIGHTS_BLOB, 0, 7), b"damaged"), now_us=0)
    for data in server.data_to_send(0):
        client.receive(data, 0)
    assert client.stats.decode_errors == 1
    told = ["the scene's own weights are not used (weights: are damaged)"]
    assert list(client.stats.notices) == told
    assert [record.getMessage() for record in caplog.records] == told
