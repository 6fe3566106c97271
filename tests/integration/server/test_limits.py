"""What the server's settings of safety do while it runs: each is felt by the client that breaks it."""

from __future__ import annotations

import asyncio
import json
import logging
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import aiohttp
import pytest
from aiohttp import web

from cags_common.errors import BundleError
from cags_common.geometry import Pose
from cags_common.runtime.rare_log import RareLog
from cags_protocol import ClientSession
from cags_protocol import events as ev
from cags_protocol.wire.encoding import decode
from cags_protocol.wire.limits import MAX_CLIENT_MESSAGE_BYTES
from cags_protocol.wire.messages import Blob, Control, PoseSample, Refusal
from cags_server import cli
from cags_server.http import app, client_task
from cags_server.http.client_task import ClientTask
from cags_server.session.connection import Connection
from cags_server.settings import ServerSettings, ServeSettings
from support.live_server import Client, now_us, serving
from support.server_scene import FakeReader, hello, library


@pytest.fixture(autouse=True)
def nothing_was_logged_yet(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client_task, "told", RareLog(client_task.log, 10.0))
    monkeypatch.setattr(client_task, "tracebacks", RareLog(client_task.log, 60.0))


def test_a_server_listens_on_this_machine_alone_unless_told_otherwise() -> None:
    assert ServeSettings(bundle="x").host == "127.0.0.1"


async def test_a_server_is_ready_until_it_drains() -> None:
    async with serving() as (running, server), aiohttp.ClientSession() as http:
        async with http.get(server.make_url("/readyz")) as answer:
            assert (answer.status, await answer.json()) == (200, {"status": "ready"})
        await running.drain()
        async with http.get(server.make_url("/readyz")) as answer:
            assert (answer.status, await answer.json()) == (503, {"status": "draining"})
        async with http.get(server.make_url("/healthz")) as answer:
            assert answer.status == 200, "it still lives"


async def test_connections_that_say_nothing_keep_nobody_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each that comes takes the place of the one that has been silent for longest."""
    monkeypatch.setattr(app, "MAX_HANDSHAKES", 3)
    async with serving(max_clients=1) as (running, server):
        silent = [await Client.join(server) for _ in range(12)]
        good = await Client.join(server)
        await good.until(ev.Welcomed)
        assert len(running._clients) <= 4
        for client in silent:
            await client.transport.close()


async def test_who_shows_the_token_waits_with_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(app, "MAX_HANDSHAKES", 2)
    async with serving(token="secret", max_clients=4) as (_, server):
        good = await Client.join(server, header_token="secret")
        silent = [await Client.join(server) for _ in range(8)]
        await good.until(ev.Welcomed)
        by_hello = await Client.join(server, token="secret")
        await by_hello.until(ev.Welcomed)
        for client in silent:
            await client.transport.close()


UPGRADE = (
    b"GET /stream HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
    b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
)


async def test_who_goes_while_waiting_for_a_turn_leaves_no_traceback(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    waiting, turn = asyncio.Event(), asyncio.Event()

    async def take(turns: app.AdmissionRate) -> bool:
        waiting.set()
        await turn.wait()
        return True

    monkeypatch.setattr(app.AdmissionRate, "take", take)
    async with serving() as (running, _):
        runner = web.AppRunner(running.web_app())  # as `serve` does; a test server cancels who waits
        await runner.setup()
        await web.TCPSite(runner, "127.0.0.1", 0).start()
        _, writer = await asyncio.open_connection(*runner.addresses[0])
        writer.write(UPGRADE)
        await waiting.wait()
        writer.transport.abort()
        await asyncio.sleep(0.1)
        turn.set()
        await asyncio.sleep(0.1)
        assert not running._clients
        await runner.cleanup()
    assert "Error handling request" not in caplog.text


async def test_too_many_poses_are_refused_by_name() -> None:
    async with serving(max_pose_rate=20.0) as (_, server):
        client = await Client.join(server)
        await client.until(ev.Welcomed)
        samples = [PoseSample(now_us() + i, Pose.identity()) for i in range(60)]
        client.session.send_poses(samples, now_us=now_us())
        (refused,) = await client.until(ev.Refused)
        assert (refused.refusal.code, refused.refusal.field) == ("quota", "poses")


async def test_a_message_of_the_largest_size_is_read() -> None:
    """It is no message, and is refused as that; one more byte would end the WebSocket with 1009."""
    async with serving() as (_, server):
        client = await Client.join(server)
        client.session.data_to_send(now_us())
        await client.transport.send(bytes(MAX_CLIENT_MESSAGE_BYTES))
        (refused,) = await client.until(ev.Refused)
        assert refused.refusal.code == "malformed"


async def test_a_message_larger_than_any_client_needs_ends_the_connection() -> None:
    async with serving() as (_, server):
        client = await Client.join(server)
        await client.until(ev.Welcomed)
        await client.transport.send(bytes(MAX_CLIENT_MESSAGE_BYTES + 1))
        (closed,) = await client.until(ev.Closed)
        assert closed.code == "lost"
        assert await (await Client.join(server)).until(ev.Welcomed)


async def test_what_may_wait_for_one_client_is_bounded() -> None:
    async with serving(max_queue_mb=0.1) as (running, server):
        client = await Client.join(server)
        await client.until(ev.Welcomed)
        (_, connection) = next(iter(running._clients.values()))
        for number in range(20):
            blob = Blob("weights", 30_000 * number, 600_000)
            connection.session.queue(ev.Outgoing(blob, bytes(30_000), 2), now_us=now_us())
        assert 60_000 < connection.session.queued_bytes <= 100_000


class Stuck:
    """A transport whose peer shakes hands and then takes nothing."""

    peer = "stuck"

    def __init__(self) -> None:
        session = ClientSession(now_us=0)
        session.hello(hello(), now_us=0)
        self.waiting = session.data_to_send(0)

    async def recv(self) -> bytes:
        if self.waiting:
            return self.waiting.pop(0)
        await asyncio.Event().wait()
        raise AssertionError

    async def send(self, data: bytes) -> None:
        await asyncio.Event().wait()

    async def close(self, reason: str = "") -> None:
        await asyncio.Event().wait()

    def abort(self) -> None:
        self.aborted = True


async def test_a_client_that_takes_nothing_is_cut_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client_task, "CLOSE_TIMEOUT_S", 0.05)
    settings = ServerSettings(reference_width=64, reference_height=48)
    connection = Connection(library(), settings, name="slow", now_us=now_us())
    with ThreadPoolExecutor(1) as executor:
        transport = Stuck()
        async with asyncio.timeout(10):
            await ClientTask(transport, connection, executor, slow_s=0.1).run()
    assert connection.ending is not None
    assert connection.ending.code == "timeout"
    assert "0.1 s" in connection.ending.reason
    assert transport.aborted, "else the socket stays open until its peer takes what is left"


class Willing(Stuck):
    """A client that says Hello and takes everything."""

    def __init__(self) -> None:
        super().__init__()
        self.taken: list[bytes] = []

    async def send(self, data: bytes) -> None:
        self.taken.append(data)

    async def close(self, reason: str = "") -> None:
        pass


@pytest.mark.parametrize(("turn_s", "most_turns", "least_turns"), [(0.1, 4, 0), (0.0, 100, 40)])
async def test_messages_that_wait_are_read_together_until_the_others_have_a_turn(
    turn_s: float, most_turns: int, least_turns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With one message a turn, twenty viewers' acknowledgements were read a second late."""
    monkeypatch.setattr(client_task, "READING_TURN_S", turn_s)
    settings = ServerSettings(reference_width=64, reference_height=48)
    connection = Connection(library(), settings, name="s", now_us=now_us())
    turns, read_at = 0, list[int]()

    def receive(data: bytes, now_us: int) -> None:
        read_at.append(turns)
        sum(range(2000))  # some work, for a clock that may be coarse
        if len(read_at) == 40:
            connection.connection_lost("read", now_us)

    monkeypatch.setattr(connection, "receive", receive)
    transport = Willing()
    transport.waiting = [b"message"] * 40
    with ThreadPoolExecutor(1) as executor:
        async with asyncio.timeout(10):
            serving_it = asyncio.create_task(ClientTask(transport, connection, executor, slow_s=1.0).run())
            while not serving_it.done():
                turns += 1
                await asyncio.sleep(0)
    assert len(read_at) == 40
    assert least_turns <= read_at[-1] - read_at[0] + 1 <= most_turns


async def test_a_fault_of_the_server_ends_its_session_with_a_word_and_a_line_in_the_log(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    connection = Connection(
        library(), ServerSettings(reference_width=64, reference_height=48), name="s", now_us=now_us()
    )

    def broken(now_us: int) -> None:
        raise RuntimeError("a fault of the program")

    monkeypatch.setattr(connection, "next_job", broken)
    transport = Willing()
    with ThreadPoolExecutor(1) as executor:
        async with asyncio.timeout(10):
            await ClientTask(transport, connection, executor, slow_s=1.0).run()
    refusal, _ = decode(transport.taken[-1])
    assert isinstance(refusal, Refusal)
    assert refusal.code == "internal"
    assert "a fault of the program" in caplog.text


async def test_a_job_whose_result_cannot_be_used_ends_its_session_with_one_traceback(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fails(connection: Connection, *arguments: Any) -> None:
        raise RuntimeError("cannot be used")

    async with serving() as (_, server):
        monkeypatch.setattr(Connection, "job_done", fails)
        for _ in range(3):
            client = await Client.join(server)
            await client.until(ev.FrameEnded)
            client.session.control(Control("play", 0, now_us() + 300_000), now_us=now_us())
            (refused,) = await client.until(ev.Refused)
            assert (refused.refusal.code, refused.refusal.message) == ("internal", "the server failed; join again")
    assert caplog.text.count("Traceback") == 1


class BeyondCapacity(FakeReader):
    """Ids that no array of the group has a row for, in the second group of frames."""

    def __init__(self) -> None:
        super().__init__()
        self.broken = True

    def at_hand(self, frame: int) -> bool:
        return frame < 6

    def tile_ids(self, frame: int, tile: int) -> Any:
        ids = super().tile_ids(frame, tile)
        return ids + 1000 if frame >= 6 and getattr(self, "broken", False) else ids


async def test_a_fault_while_fetching_ends_the_session_with_one_line(caplog: pytest.LogCaptureFixture) -> None:
    async with serving(library(BeyondCapacity())) as (_, server):
        client = await Client.join(server, start_frame=7)
        (refused,) = await client.until(ev.Refused)
        assert refused.refusal.code == "internal"
        assert await (await Client.join(server)).until(ev.FrameEnded), "others go on"
    assert caplog.text.count("ended by a fault") == 1
    assert caplog.text.count("Traceback") == 1


class Vanishing(FakeReader):
    """A bundle that is deleted while it is served."""

    def __init__(self) -> None:
        super().__init__()
        self.gone = False

    def source_delta(self, frame: int) -> Any:
        if self.gone:
            raise BundleError("clip.cags/source-0.bin: is not there any more")
        return super().source_delta(frame)

    source = source_delta  # type: ignore[assignment]


async def test_a_bundle_that_is_gone_costs_a_line_and_no_traceback_a_frame(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client_task, "FAILING_S", 0.1)
    reader = Vanishing()
    scene = library(reader)
    async with serving(scene) as (_, server):
        reader.gone = True
        client = await Client.join(server)
        await client.until(ev.FrameEnded)
        client.session.control(Control("play", 0, now_us() + 300_000), now_us=now_us())
        (refused,) = await client.until(ev.Refused)
    assert refused.refusal.message == "the server cannot read the scene at present; join again later"
    assert "Traceback" not in caplog.text
    assert caplog.text.count("has no reference") == 1
    assert caplog.text.count("ended, as the scene cannot be read") == 1


def test_the_log_is_json_where_that_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[logging.Handler] = []
    monkeypatch.setattr(logging, "basicConfig", lambda **named: started.extend(named["handlers"]))
    for log_format in ("json", "text"):
        cli._start_logging(ServeSettings(bundle="x", log_format=log_format))
    record = logging.LogRecord("x", logging.ERROR, "x.py", 1, "%s: frame %d failed", ("s1", 7), None)
    record.created, record.msecs = 1_790_000_000.25, 250.0
    as_json, as_text = (handler.format(record) for handler in started)
    assert json.loads(as_json).items() >= {"level": "ERROR", "message": "s1: frame 7 failed"}.items()
    assert as_text == "2026-09-21T14:13:20.250Z ERROR s1: frame 7 failed"
    assert json.loads(as_json)["time"] == "2026-09-21T14:13:20.250Z"
    try:
        raise ValueError("why")
    except ValueError as error:
        record.exc_info = (ValueError, error, error.__traceback__)
    assert "ValueError: why" in json.loads(started[0].format(record))["error"]
