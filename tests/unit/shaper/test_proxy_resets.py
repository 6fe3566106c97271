"""Connections that are reset, and too many of them: what a shaper does for the others goes on."""

import asyncio
import socket
import struct
from pathlib import Path

import pytest

from cags_shaper import proxy as proxy_module
from cags_shaper.link import Link, LinkSettings
from cags_shaper.log import LogWriter, close_log, open_log
from cags_shaper.proxy import ShaperProxy
from cags_shaper.service import Service
from cags_shaper.settings import ShaperSettings
from cags_shaper.trace import open_trace
from unit.shaper.test_proxy import echo, exchange, shaped


def reset(writer):
    """End a connection with a reset instead of an orderly end."""
    sock = writer.get_extra_info("socket")
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    writer.transport.abort()


async def test_a_reset_before_the_end_of_a_stream_leaves_the_link_to_the_others():
    """The transport is not reading (its uplink is full), so only the ``shutdown`` tells that the peer is gone."""
    ended = asyncio.Event()

    async def deaf(reader, writer):
        if not ended.is_set():
            await ended.wait()
            writer.write_eof()
            writer.close()
        else:
            await echo(reader, writer)

    down = Link(None, LinkSettings(delay_us=200_000))
    up = Link(open_trace("generated:steady-1"), LinkSettings(queue_bytes=3000))
    async with shaped(deaf, down, up) as (proxy, address):
        _, writer = await asyncio.open_connection(*address)
        writer.write(bytes(1_000_000))
        await asyncio.sleep(0.2)
        ended.set()
        await asyncio.sleep(0.1)
        reset(writer)
        await asyncio.sleep(0.3)
        assert not proxy.downlink._task.done()
        async with asyncio.timeout(10):
            assert await exchange(address, b"still there") == b"still there"


async def test_the_oldest_connection_makes_room_for_one_more(monkeypatch):
    monkeypatch.setattr(proxy_module, "MAX_CONNECTIONS", 4)
    async with shaped(echo) as (proxy, address):
        silent = [await asyncio.open_connection(*address) for _ in range(10)]
        async with asyncio.timeout(5):
            assert await exchange(address, b"through") == b"through"
        assert len(proxy._connections) <= 4
        with pytest.raises((ConnectionError, asyncio.IncompleteReadError)):
            await silent[0][0].readexactly(1)
        for _, writer in silent:
            writer.transport.abort()
        await asyncio.sleep(0.05)


async def test_a_link_that_stops_is_told_at_once(monkeypatch, caplog):
    async with shaped(echo) as (proxy, address):
        monkeypatch.setattr(proxy_module, "_write", lambda piece: 1 / 0)
        _, writer = await asyncio.open_connection(*address)
        writer.write(b"x")
        async with asyncio.timeout(5):
            with pytest.raises(ZeroDivisionError):
                await proxy.stopped()
        writer.transport.abort()
    assert "the link has stopped" in caplog.text


async def test_a_shaper_whose_link_stops_ends_with_a_word(monkeypatch, caplog):
    server = await asyncio.start_server(echo, "127.0.0.1", 0)
    to = f"127.0.0.1:{server.sockets[0].getsockname()[1]}"
    service = Service(ShaperSettings(to=to), [None, None], True)
    started = asyncio.get_running_loop().create_future()
    start = ShaperProxy.start

    async def told(self, *arguments):
        address = await start(self, *arguments)
        started.set_result(address)
        return address

    monkeypatch.setattr(ShaperProxy, "start", told)
    monkeypatch.setattr(proxy_module, "_write", lambda piece: 1 / 0)
    running = asyncio.create_task(service.run())
    _, writer = await asyncio.open_connection(*(await started))
    writer.write(b"x")
    async with asyncio.timeout(5):
        with pytest.raises(Exception, match="the link has stopped"):
            await running
    writer.transport.abort()
    server.close()
    await asyncio.sleep(0.05)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no full disk at hand")
async def test_a_disk_that_is_full_does_not_stop_the_link(caplog):
    file = open_log("/dev/full")
    writer = LogWriter(file, ShaperSettings())
    async with shaped(echo) as (proxy, address):
        proxy.begin()
        for _ in range(3):
            writer.sample("down", proxy.downlink)
        assert await exchange(address, b"through") == b"through"
    close_log(file)
    assert caplog.text.count("the log cannot be written (No space left on device)") == 1
