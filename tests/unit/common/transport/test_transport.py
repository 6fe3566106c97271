import asyncio
import contextlib
import socket

import pytest
from aiohttp import web
from websockets.exceptions import ConnectionClosed

from cags_common.errors import NetworkError
from cags_common.transport import ConnectionEndedError, memory_pair
from cags_common.transport.tcp import NOTSENT_BYTES, TCP_NOTSENT_LOWAT, tcp_info
from cags_common.transport.websocket import ServerWebSocket, connect

PROTOCOL = {"subprotocol": "cags.v1", "max_message_bytes": 1 << 20}


@contextlib.asynccontextmanager
async def serving(handler):
    """An aiohttp server at ``/stream``; ``handler`` gets the transport. Yields the URL."""

    async def stream(request):
        transport = await ServerWebSocket.accept(request, **PROTOCOL)
        await handler(transport)
        return transport.response

    async def page(request):
        return web.Response(text="<!doctype html>", content_type="text/html")

    app = web.Application()
    app.router.add_get("/stream", stream)
    app.router.add_get("/", page)
    runner = web.AppRunner(app)
    await runner.setup()
    site = web.TCPSite(runner, "127.0.0.1", 0)
    await site.start()
    try:
        yield f"ws://127.0.0.1:{runner.addresses[0][1]}/stream"
    finally:
        await runner.cleanup()


async def echo(transport):
    with contextlib.suppress(ConnectionEndedError):
        while True:
            await transport.send(await transport.recv())


async def test_messages_go_both_ways():
    async with serving(echo) as url:
        client = await connect(url, **PROTOCOL)
        for data in (b"a", bytes(8192), b""):
            await client.send(data)
            assert await client.recv() == data
        await client.close()


async def test_little_may_wait_in_process_and_kernel():
    seen = {}

    async def look(transport):
        seen["high"] = transport._transport.get_write_buffer_limits()[1]
        sock = transport._transport.get_extra_info("socket")
        seen["lowat"] = sock.getsockopt(socket.IPPROTO_TCP, TCP_NOTSENT_LOWAT)
        seen["info"] = transport.tcp_info()
        seen["compress"] = transport.response.compress
        await transport.close()

    async with serving(look) as url:
        client = await connect(url, **PROTOCOL)
        with pytest.raises(ConnectionEndedError):
            await client.recv()
        await client.close()
    assert seen["high"] == 8192
    assert seen["lowat"] == NOTSENT_BYTES
    assert not seen["compress"]
    assert seen["info"].rtt_us > 0


async def test_a_sender_waits_for_a_reader_that_does_not_read():
    sent = 0

    async def pour(transport):
        nonlocal sent
        with contextlib.suppress(ConnectionEndedError):
            for _ in range(10_000):
                await transport.send(bytes(8192))
                sent += 1

    async with serving(pour) as url:
        client = await connect(url, **PROTOCOL)
        await asyncio.sleep(0.3)
        assert sent < 10_000
        await client.close()


async def test_the_reason_of_a_close_reaches_the_client():
    async def leave(transport):
        await transport.close("draining " + "x" * 200)

    async with serving(leave) as url:
        client = await connect(url, **PROTOCOL)
        with pytest.raises(ConnectionEndedError, match=r"/stream: closed by the server \(draining"):
            await client.recv()
        with pytest.raises(ConnectionEndedError):
            await client.send(b"x")
        await client.close()


async def test_text_and_oversized_messages_end_the_connection():
    ended = []

    async def listen(transport):
        with pytest.raises(ConnectionEndedError) as error:
            await transport.recv()
        ended.append(str(error.value))

    async with serving(listen) as url:
        for bad in ("text", bytes((1 << 20) + 1)):
            client = await connect(url, **PROTOCOL)
            with contextlib.suppress(ConnectionClosed):  # refused as soon as its length is known
                await client._ws.send(bad)
            with pytest.raises(ConnectionEndedError):
                await client.recv()
            await client.close()
    assert "sent text" in ended[0]
    assert len(ended) == 2


async def refused_port():
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        return sock.getsockname()[1]


async def test_a_refused_connection_names_the_url():
    url = f"ws://127.0.0.1:{await refused_port()}/stream"
    with pytest.raises(NetworkError, match=rf"{url}: cannot connect \(connection refused"):
        await connect(url, **PROTOCOL)


async def test_wrong_addresses_are_one_line():
    async with serving(echo) as url:
        with pytest.raises(
            NetworkError, match=r"refused with HTTP 404.*; a server's stream is at ws://HOST:PORT/stream"
        ):
            await connect(url + "/nowhere", **PROTOCOL)
        with pytest.raises(NetworkError, match=r"is a page and no stream.*ws://HOST:PORT/stream"):
            await connect(url.removesuffix("stream"), **PROTOCOL)
    with pytest.raises(NetworkError, match="is not a WebSocket address"):
        await connect("http://127.0.0.1/", **PROTOCOL)


async def test_a_peer_that_never_answers_times_out():
    with socket.socket() as mute:
        mute.bind(("127.0.0.1", 0))
        mute.listen()
        with pytest.raises(NetworkError, match=r"no answer within 0\.1 s"):
            await connect(f"ws://127.0.0.1:{mute.getsockname()[1]}/", timeout_s=0.1, **PROTOCOL)


async def test_a_peer_that_is_no_web_server_is_named():
    async def shout(reader, writer):
        writer.write(b"220 smtp ready\r\n")
        writer.close()

    server = await asyncio.start_server(shout, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    with pytest.raises(NetworkError, match=rf"127\.0\.0\.1:{port}/"):
        await connect(f"ws://127.0.0.1:{port}/", **PROTOCOL)
    server.close()


async def test_memory_pairs_carry_messages_and_ends():
    a, b = memory_pair()
    await a.send(b"x")
    assert await b.recv() == b"x"
    await a.close()
    await a.close()
    with pytest.raises(ConnectionEndedError):
        await b.recv()
    with pytest.raises(ConnectionEndedError):
        await b.send(b"y")


def test_no_tcp_figures_for_what_is_not_tcp():
    with socket.socket(socket.AF_UNIX) as sock:
        assert tcp_info(sock) is None
    assert tcp_info(None) is None
