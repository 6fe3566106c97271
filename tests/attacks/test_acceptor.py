"""Attacks on the accepting of connections: connections that have shown nothing keep nobody out and fill no log."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import socket
import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from aiohttp import web

from cags_common.transport import accepting
from cags_common.transport.accepting import listen_on
from cags_server.http import acceptor as acceptor_module
from cags_server.http.acceptor import Acceptor
from cags_server.http.admission import tls_context
from integration.server.test_app import self_signed


async def ok(request: web.Request) -> web.Response:
    return web.Response(text="ok")


@asynccontextmanager
async def opened(acceptor: Acceptor, tls: ssl.SSLContext | None = None) -> AsyncIterator[int]:
    """An acceptor before a server of one page; yields its port."""
    app = web.Application(middlewares=[acceptor.middleware()])
    app.router.add_get("/", ok)
    runner = web.AppRunner(app)
    await runner.setup()
    assert runner.server is not None
    listeners = listen_on("127.0.0.1", 0, 16)
    faults: list[BaseException] = []
    acceptor.open(listeners, runner.server, tls, faults.append)
    yield listeners[0].getsockname()[1]
    await acceptor.close()
    await runner.cleanup()
    await asyncio.sleep(0)
    assert not faults
    assert len(acceptor) == 0


async def asked(port: int) -> str:
    """The page, on a connection of its own."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(b"GET / HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n")
    answer = await reader.read()
    writer.close()
    return answer.decode()


async def ended(reader: asyncio.StreamReader) -> bool:
    """Whether the connection is over."""
    try:
        return await reader.read(1) == b""
    except ConnectionError:
        return True


async def test_a_header_that_does_not_come_ends_the_connection(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(acceptor_module, "HEADER_S", 0.3)
    async with opened(Acceptor(64)) as port:
        _, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"GET / HTTP/1.1\r\n")
        async with asyncio.timeout(5):
            with contextlib.suppress(ConnectionError):
                while True:
                    writer.write(b"X-More: 1\r\n")
                    await writer.drain()
                    await asyncio.sleep(0.05)
        writer.transport.abort()


async def test_one_too_many_ends_the_oldest_of_the_address_that_has_most() -> None:
    acceptor = Acceptor(64, max_waiting=4)
    async with opened(acceptor) as port:
        held = []
        for _ in range(12):
            held.append(await asyncio.open_connection("127.0.0.1", port))
            await asyncio.sleep(0.01)
        assert acceptor.waiting <= 4
        assert "ok" in await asked(port)
        assert await ended(held[0][0])
        for _, writer in held:
            writer.transport.abort()


async def test_where_all_connections_are_in_use_one_more_is_ended_at_once() -> None:
    acceptor = Acceptor(2)
    async with opened(acceptor) as port:
        held = [await asyncio.open_connection("127.0.0.1", port) for _ in range(6)]
        await asyncio.sleep(0.1)
        assert len(acceptor) <= 2
        for _, writer in held:
            writer.transport.abort()


async def test_a_tls_handshake_that_does_not_come_ends_the_connection(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(acceptor_module, "HEADER_S", 0.3)
    acceptor = Acceptor(64)
    async with opened(acceptor, tls_context(*self_signed(tmp_path))) as port:
        silent = [await asyncio.open_connection("127.0.0.1", port) for _ in range(5)]
        plain = await asyncio.open_connection("127.0.0.1", port)
        plain[1].write(b"GET / HTTP/1.1\r\n\r\n")
        async with asyncio.timeout(5):
            while len(acceptor):  # noqa: ASYNC110
                await asyncio.sleep(0.02)
        for _, writer in [*silent, plain]:
            writer.transport.abort()


async def test_descriptors_that_run_out_cost_a_line_and_not_the_door(caplog: pytest.LogCaptureFixture) -> None:
    loop, relieved = asyncio.get_running_loop(), 0
    accept, failing = loop.sock_accept, [OSError(errno.EMFILE, "Too many open files")] * 3

    def relieve() -> None:
        nonlocal relieved
        relieved += 1

    async def sock_accept(listener: socket.socket) -> tuple[socket.socket, object]:
        if failing:
            raise failing.pop()
        return await accept(listener)

    taken: asyncio.Queue[socket.socket] = asyncio.Queue()
    (listener,) = accepting.listen_on("127.0.0.1", 0, 4)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop, "sock_accept", sock_accept)
        log = logging.getLogger("cags_test")
        accepting_all = asyncio.create_task(accepting.accept_all(listener, taken.put_nowait, log, relieve=relieve))
        _, writer = await asyncio.open_connection(*listener.getsockname())
        async with asyncio.timeout(5):
            (await taken.get()).close()
        accepting_all.cancel()
        await asyncio.gather(accepting_all, return_exceptions=True)
    writer.transport.abort()
    listener.close()
    assert relieved == 3
    assert caplog.text.count("no more connections can be accepted") == 1
