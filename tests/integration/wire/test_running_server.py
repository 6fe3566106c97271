"""The server's own application, on a real port, under WebSocket conformance cases and wrong messages."""

import asyncio
import contextlib
import logging
import random

import aiohttp
import pytest
from aiohttp import WSMsgType, web

from cags_common.errors import NetworkError
from cags_common.transport.websocket import ServerWebSocket, connect
from cags_protocol import ClientSession
from cags_protocol import events as ev
from cags_protocol.wire.encoding import encode
from cags_protocol.wire.limits import MAX_MESSAGE_BYTES, SUBPROTOCOL
from cags_server.http.app import App
from cags_server.scene.collection import Collection
from cags_server.settings import ServeSettings
from support.server_scene import hello, library
from support.wire_fuzz import fuzzed

LEFT_OUT = ["9.*", "12.*", "13.*"]
"""Performance and compression: the former measure nothing here, the latter is never negotiated."""

AIOHTTP_FAILS = {"7.9.5"}
"""Cases that aiohttp itself fails: it answers an invalid close code by 1000 where 1002 is asked for."""


@contextlib.asynccontextmanager
async def listening(app):
    runner = web.AppRunner(app, access_log=None)
    await runner.setup()
    await web.TCPSite(runner, "127.0.0.1", 0).start()
    try:
        yield runner.addresses[0][1]
    finally:
        await runner.cleanup()


@pytest.fixture
async def server():
    """Port of a running server of a small scene."""
    app = App(
        Collection.of(library()),
        ServeSettings(bundle="unused", rasteriser="oracle", reference_width=64, reference_height=48),
    )
    async with listening(app.web_app()) as port:
        yield port
    app.close()


async def failures(url):
    """Numbers of the cases that fail."""
    kosoku = pytest.importorskip("kosoku", reason="conformance cases need `pip install kosoku`")
    try:
        await kosoku.run_fuzzingclient(url, None, LEFT_OUT, concurrency=8)
    except kosoku.FailureError as failure:
        lines = str(failure).splitlines()[1:]
        return {line.split(":")[0].strip() for line in lines}
    return set()


async def echo(request):
    ws = (await ServerWebSocket.accept(request, subprotocol=SUBPROTOCOL, max_message_bytes=MAX_MESSAGE_BYTES)).response
    async for message in ws:
        if message.type is WSMsgType.TEXT:
            await ws.send_str(message.data)
        elif message.type is WSMsgType.BINARY:
            await ws.send_bytes(message.data)
    return ws


async def test_our_websocket_fails_no_case_that_aiohttp_passes():
    app = web.Application()
    app.router.add_get("/", echo)
    async with listening(app) as port:
        assert await failures(f"ws://127.0.0.1:{port}/") <= AIOHTTP_FAILS


async def test_the_server_outlives_every_case(server, caplog):
    """A stream echoes nothing, so the verdicts mean nothing; what counts is that each case leaves the server well."""
    await failures(f"ws://127.0.0.1:{server}/stream")
    await check_alive(server, caplog)


@pytest.mark.parametrize("seed", range(3))
async def test_the_server_outlives_wrong_messages(server, caplog, seed):
    rng = random.Random(seed)
    for _ in range(40):
        client = await connect(f"ws://127.0.0.1:{server}/stream", subprotocol=SUBPROTOCOL, max_message_bytes=1 << 20)
        with contextlib.suppress(NetworkError):
            if rng.random() < 0.7:
                await client.send(encode(hello()))
            for _ in range(rng.randrange(1, 6)):
                await client.send(fuzzed(rng))
        await client.close()
    await check_alive(server, caplog)


async def test_a_peer_that_only_connects_is_let_go_when_it_leaves(server, caplog):
    _, writer = await asyncio.open_connection("127.0.0.1", server)
    writer.write(b"GET /stream HTTP/1.1\r\n")
    await writer.drain()
    writer.close()
    await check_alive(server, caplog)


async def check_alive(port, caplog):
    """Nothing was logged as an error, no client is left behind, and a good one is served."""
    assert not [record for record in caplog.records if record.levelno >= logging.ERROR]
    async with aiohttp.ClientSession() as http:
        for _ in range(100):
            async with http.get(f"http://127.0.0.1:{port}/healthz") as answer:
                health = await answer.json()
            if health["clients"] == 0:
                break
            await asyncio.sleep(0.05)
    assert (health["status"], health["clients"]) == ("ok", 0)
    assert isinstance(await join(port), ev.Welcomed)


async def join(port):
    """The first event of a good client."""
    transport = await connect(f"ws://127.0.0.1:{port}/stream", subprotocol=SUBPROTOCOL, max_message_bytes=1 << 20)
    session = ClientSession(now_us=0)
    session.hello(hello(), now_us=0)
    for data in session.data_to_send(0):
        await transport.send(data)
    while (event := session.next_event()) is None:
        session.receive(await transport.recv(), now_us=1)
    await transport.close()
    return event
