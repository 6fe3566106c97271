"""The real-time shell: whatever goes wrong while it reads ends the play, at once and by name."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from cags_client.app import Shell, looked_at, now_us
from cags_client.frame.pipeline import ClientPipeline
from cags_client.frame.presented import PresentedFrame
from cags_client.net import connection
from cags_client.output.report import summary
from cags_client.output.sinks import FrameStats
from cags_client.playback import player
from cags_client.playback.jobs import Decode, Present, Traffic
from cags_client.playback.player import Player
from cags_client.settings import ClientSettings
from cags_common.bundle.manifest import Manifest
from cags_common.errors import BundleError, NetworkError
from cags_common.geometry import Pose
from cags_common.tiles.inventory import InventoryEntry
from cags_common.transport import MemoryTransport, memory_pair
from cags_protocol import ClientSession
from cags_protocol import events as ev
from cags_protocol.wire.encoding import decode, encode
from cags_protocol.wire.messages import Fragment, Hello, Refusal, TileLayers, Welcome
from support.small_store import books, manifest

MANIFEST = Manifest("t", 30.0, 3, (0,), (1,), 0, ((0, 0, 0), (1, 1, 1)), (), ())


class Still:
    def pose_at(self, t_us: int) -> Pose:
        return Pose.identity()


async def nowhere(attempt: int) -> MemoryTransport:
    raise NetworkError("there is no other server")


def shell(**settings: Any) -> tuple[Shell, MemoryTransport]:
    """A client's shell that has said Hello, and the server's end of its connection."""
    ours, theirs = memory_pair()
    made = Player(ClientSession(now_us=now_us()), ClientSettings(**settings), Still(), now_us=now_us())
    return Shell(ours, made, (), None, nowhere), theirs


async def test_a_manifest_that_cannot_be_read_ends_the_play_at_once() -> None:
    client, server = shell()
    await server.send(encode(Welcome("s", 30.0, 3, False, b'{"format": "something else"}')))
    async with asyncio.timeout(5):
        await client.run()
    client.close()
    assert isinstance(client.player.error, BundleError)


async def test_groups_larger_than_the_viewer_gives_memory_for_end_the_play_at_once() -> None:
    client, server = shell()
    huge = replace(MANIFEST, capacity=(ClientSettings().max_splats + 1,))
    await server.send(encode(Welcome("s", 30.0, 3, False, huge.to_json())))
    async with asyncio.timeout(5):
        await client.run()
    client.close()
    assert "4000001 splats, and this client takes 4000000; see --max-splats" in str(client.player.error)


async def test_groups_that_take_more_memory_than_the_viewer_gives_end_the_play_at_once() -> None:
    client, server = shell(max_memory_mb=2048.0)
    huge = replace(MANIFEST, sh_degree=3, capacity=(3_000_000,))
    await server.send(encode(Welcome("s", 30.0, 3, False, huge.to_json())))
    async with asyncio.timeout(5):
        await client.run()
    client.close()
    assert "3000000 splats, which take 3186 MB; this client gives 2048; see --max-memory-mb" in str(client.player.error)


async def test_a_fault_while_reading_is_raised_and_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    client, server = shell()

    def broken(data: bytes, now_us: int) -> None:
        raise RuntimeError("a fault of the program")

    monkeypatch.setattr(client.player, "receive", broken)
    await server.send(b"anything")
    with pytest.raises(RuntimeError, match="a fault of the program"):
        async with asyncio.timeout(5):
            await client.run()
    client.close()


def test_what_was_given_up_for_want_of_memory_is_told_to_the_server(monkeypatch: pytest.MonkeyPatch) -> None:
    client, _ = shell()
    told = list[InventoryEntry]()
    monkeypatch.setattr(client.player._session, "report_evictions", told.extend)
    pipe = ClientPipeline(manifest(), ClientSettings())
    pipe.on_codebooks(books().to_bytes())
    monkeypatch.setattr("cags_common.store.reorder_buffer.MAX_WAITING_BYTES", 100)
    late = [ev.TileReceived(TileLayers(0, n, 1, 2, (60,), (0,)), memoryview(bytes(60))) for n in range(3)]
    decode = Decode(tuple(late), pipe)
    client.player.done(decode, decode.run(), now_us())
    assert told == [InventoryEntry(0, 0, 0), InventoryEntry(0, 1, 0)]


def tiles(count: int, size: int) -> list[bytes]:
    """Packets of a message each, as a server writes them."""
    messages = [encode(TileLayers(0, number, 0, 1, (size,), (0,)), bytes(size)) for number in range(count)]
    return [encode(Fragment(seq, seq), data) for seq, data in enumerate(messages, start=1)]


async def test_tiles_without_codebooks_end_the_play_before_they_fill_the_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(player, "MAX_UNDECODED_BYTES", 10_000)
    client, server = shell()
    await server.send(encode(Welcome("s", 30.0, 3, False, MANIFEST.to_json())))
    for packet in tiles(12, 1_000):
        await server.send(packet)
    async with asyncio.timeout(5):
        await client.run()
    client.close()
    assert "without the codebooks" in str(client.player.error)


async def test_a_client_whose_decoder_lags_stops_reading_until_it_has_caught_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    client, server = shell()
    received: list[bytes] = []
    behind = True
    monkeypatch.setattr(client.player, "receive", lambda data, now_us: received.append(data))
    monkeypatch.setattr(Player, "backed_up", property(lambda _: behind and len(received) >= 2))
    running = asyncio.create_task(client.run())
    for number in range(4):
        await server.send(bytes([number]))
    await asyncio.sleep(0.1)
    assert len(received) == 2
    behind = False
    client.wake()  # as the end of any decoding does
    await asyncio.sleep(0.1)
    assert len(received) == 4
    client.leave(signal.SIGINT)
    async with asyncio.timeout(5):
        await running
    client.close()


class Stalled(MemoryTransport):
    """A link that takes nothing from some time on, and never says so."""

    def __init__(self, ours: MemoryTransport) -> None:
        self._ours, self.stalls, self.aborted = ours, False, False

    async def send(self, data: bytes) -> None:
        if self.stalls:
            await asyncio.Event().wait()
        await self._ours.send(data)

    async def recv(self) -> bytes:
        return await self._ours.recv()

    async def close(self, reason: str = "") -> None:
        if self.stalls:
            await asyncio.Event().wait()
        await self._ours.close()

    def abort(self) -> None:
        self.aborted = True


def stalled_shell() -> tuple[Shell, Stalled, MemoryTransport]:
    ours, theirs = memory_pair()
    link = Stalled(ours)
    made = Player(ClientSession(now_us=now_us()), ClientSettings(), Still(), now_us=now_us())
    return Shell(link, made, (), None, nowhere), link, theirs


async def test_the_end_of_a_server_that_refused_is_not_that_of_the_attempt_at_the_next() -> None:
    """A server hangs up after it has refused; the next one is being connected to by then."""
    first, second = memory_pair(), memory_pair()
    tried: list[int] = []

    async def connect(attempt: int) -> MemoryTransport:
        tried.append(attempt)
        await asyncio.sleep(0.02)
        return second[0]

    made = Player(ClientSession(now_us=now_us()), ClientSettings(), Still(), now_us=now_us(), others=1)
    client = Shell(first[0], made, (), None, connect)
    wants = made.wants_connection

    def wants_connection(now_us: int) -> bool:
        if wanted := wants(now_us):
            first[1].abort()
        return wanted

    made.wants_connection = wants_connection  # type: ignore[method-assign]
    await first[1].send(encode(Refusal("full", "", "it is full")))
    running = asyncio.create_task(client.run())
    async with asyncio.timeout(5):
        assert type(decode(await second[1].recv())[0]) is Hello
        await second[1].send(encode(Welcome("s", 30.0, 3, False, b"no manifest")))
        await running
    client.close()
    assert tried == [0]
    assert isinstance(made.error, BundleError), "what the second server says counts"


async def test_a_link_that_stalls_keeps_nothing_from_being_read(monkeypatch: pytest.MonkeyPatch) -> None:
    client, link, server = stalled_shell()
    read: list[bytes] = []
    link.stalls = True
    monkeypatch.setattr(client.player, "receive", lambda data, now_us: read.append(data))
    running = asyncio.create_task(client.run())
    for number in range(5):
        await server.send(bytes([number]))
        await asyncio.sleep(0.02)
    client.leave(signal.SIGTERM)
    async with asyncio.timeout(5.0):  # of which it waits 0.6: the rest is a busy machine's
        await running
    client.close()
    assert read == [bytes([number]) for number in range(5)]
    assert link.aborted


async def test_a_stalled_link_takes_no_memory_without_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "MAX_UNSENT_BYTES", 1000)
    lost: list[str] = []
    link = Stalled(memory_pair()[0])
    link.stalls = True
    made = connection.Connection(link, lambda _, reason: lost.append(reason))
    for _ in range(100):
        made.send([bytes(100)])
    assert lost == ["the link takes nothing any more"]
    assert made._unsent_bytes == 0
    await made.close()


async def test_what_waits_is_written_before_the_end() -> None:
    ours, theirs = memory_pair()
    made = connection.Connection(ours, lambda _, reason: None)
    made.send([b"one", b"two"])
    await made.close()
    assert [await theirs.recv(), await theirs.recv()] == [b"one", b"two"]


class Slow(MemoryTransport):
    """A link whose other end answers a close after a second, as a busy server does."""

    def __init__(self) -> None:
        self.closed, self.aborted = False, False

    async def send(self, data: bytes) -> None:
        pass

    async def recv(self) -> bytes:
        return await asyncio.Event().wait()  # type: ignore[return-value]

    async def close(self, reason: str = "") -> None:
        await asyncio.sleep(1.0)
        self.closed = True

    def abort(self) -> None:
        self.aborted = True


async def ended(link: Slow, player_ends: bool, then: Callable[[Shell], None] = lambda shell: None) -> None:
    """Run a shell to its end, by itself or by a signal; ``then`` a moment later."""
    player = Player(ClientSession(now_us=now_us()), ClientSettings(), Still(), now_us=now_us())
    client = Shell(link, player, (), None, nowhere)
    running = asyncio.create_task(client.run())
    await asyncio.sleep(0.05)
    if player_ends:
        player.leave(now_us())
        client.wake()
    else:
        client.leave(signal.SIGTERM)
    await asyncio.sleep(0.05)
    then(client)
    async with asyncio.timeout(20):
        await running
    client.close()


async def test_a_busy_server_is_left_time_to_hear_goodbye() -> None:
    link = Slow()
    await ended(link, player_ends=True)
    assert link.closed
    assert not link.aborted, "a reset overtakes the goodbye: the server would call this viewer lost"


@pytest.mark.parametrize("player_ends", [True, False])
async def test_a_signal_does_not_wait_for_a_busy_server(player_ends: bool) -> None:
    link = Slow()
    await ended(link, player_ends, (lambda shell: shell.leave(signal.SIGINT)) if player_ends else lambda shell: None)
    assert link.aborted
    assert not link.closed


class File:
    """A sink of media frames."""

    def __init__(self) -> None:
        self.shown: list[float] = []

    def show(self, presented: PresentedFrame, stats: FrameStats) -> None:
        self.shown.append(presented.frame + presented.share)

    def close(self, *, completed: bool) -> None: ...


class Page(File):
    """A sink that somebody looks at."""

    def show_between(self, presented: PresentedFrame) -> None:
        self.shown.append(presented.frame + presented.share)


async def test_pictures_between_frames_go_to_who_looks_and_are_counted_apart() -> None:
    file, page = File(), Page()
    ours, _ = memory_pair()
    made = Player(ClientSession(now_us=now_us()), ClientSettings(), Still(), now_us=now_us())
    client = Shell(ours, made, (file, page), None, nowhere)
    pipe = ClientPipeline(manifest(), ClientSettings(width=16, height=12))
    pipe.on_codebooks(books().to_bytes())
    made._next_tick, made._end_tick = 5, 9
    for share in (0.0, 0.5):
        await client._present(Present(4, now_us(), Pose.identity(), pipe, Traffic(), share))
    await asyncio.gather(*client._tasks)
    client.close()
    assert (file.shown, page.shown) == ([4.0], [4.0, 4.5])
    assert [record["frame"] for record in client.records] == [4]
    last = summary(client.records, made.stats)
    assert (last["frames"], last["frames_interpolated"]) == (1, 1)


def test_without_a_live_page_pictures_between_frames_are_drawn_only_when_asked_for() -> None:
    for mode, sinks, wanted in (
        ("auto", (File(),), "off"),
        ("auto", (File(), Page()), "auto"),
        ("on", (File(),), "on"),
        ("off", (Page(),), "off"),
    ):
        assert looked_at(ClientSettings(interpolate=mode), sinks).interpolate == wanted
