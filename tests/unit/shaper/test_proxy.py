import asyncio
import contextlib
import json
import signal
import socket
import subprocess
import sys
import time

import pytest

from cags_common.errors import NetworkError
from cags_shaper.cli import main
from cags_shaper.link import Link, LinkSettings
from cags_shaper.proxy import ShaperProxy
from cags_shaper.trace import open_trace


def clock():
    return time.monotonic_ns() // 1000


@contextlib.asynccontextmanager
async def shaped(handler, down=None, up=None):
    """A server running ``handler`` behind a proxy; yields the proxy and its address."""
    server = await asyncio.start_server(handler, "127.0.0.1", 0)
    proxy = ShaperProxy(server.sockets[0].getsockname()[:2], down or Link(None), up or Link(None))
    address = await proxy.start("127.0.0.1", 0, clock)
    try:
        yield proxy, address
    finally:
        await proxy.close()
        server.close()


async def echo(reader, writer):
    while data := await reader.read(65536):
        writer.write(data)
        await writer.drain()
    writer.write_eof()
    writer.close()


async def exchange(address, data):
    reader, writer = await asyncio.open_connection(*address)

    async def send():
        writer.write(data)
        await writer.drain()
        writer.write_eof()

    _, answer = await asyncio.gather(send(), reader.read(-1))
    writer.close()
    return answer


async def test_both_directions_carry_every_byte_in_order():
    data = bytes(i % 251 for i in range(400_000))
    settings = LinkSettings(delay_us=2000, queue_bytes=20_000)
    trace = open_trace("generated:steady-100")
    async with shaped(echo, Link(trace, settings), Link(trace, settings)) as (proxy, address):
        assert await exchange(address, data) == data
        assert proxy.downlink.link.coming_packets == 0


async def test_connections_share_the_link():
    async with shaped(echo, Link(open_trace("generated:steady-50"), LinkSettings(queue_bytes=50_000))) as (_, address):
        answers = await asyncio.gather(*(exchange(address, bytes([i]) * 50_000) for i in range(4)))
    assert [set(a) for a in answers] == [{i} for i in range(4)]
    assert all(len(a) == 50_000 for a in answers)


async def test_a_slow_link_holds_the_sender_back():
    sent = 0

    async def pour(reader, writer):
        nonlocal sent
        with contextlib.suppress(ConnectionError):
            for _ in range(1000):
                writer.write(bytes(8192))
                await writer.drain()
                sent += 8192

    link = Link(open_trace("generated:steady-1"), LinkSettings(queue_bytes=10_000))
    async with shaped(pour, link) as (_, address):
        _, writer = await asyncio.open_connection(*address)
        await asyncio.sleep(0.3)
        writer.close()
        queued = link.queued_bytes(10**9)
    assert queued <= 10_000
    assert sent < 8_000_000


async def test_a_target_that_is_gone_closes_the_connection_and_is_told(caplog):
    proxy = ShaperProxy(("127.0.0.1", 1), Link(None), Link(None))
    address = await proxy.start("127.0.0.1", 0, clock)
    reader, writer = await asyncio.open_connection(*address)
    assert await reader.read() == b""
    writer.close()
    await proxy.close()
    assert [record.getMessage() for record in caplog.records] == [
        "127.0.0.1:1: no server answers (Connection refused); start cags-server there, or give its address by --to"
    ]


async def test_a_port_in_use_is_one_clear_line():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        proxy = ShaperProxy(("127.0.0.1", 1), Link(None), Link(None))
        with pytest.raises(NetworkError, match=f"127.0.0.1:{port} is in use"):
            await proxy.start("127.0.0.1", port, clock)


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["--trace", "nowhere.csv"], 1, "nowhere.csv: cannot be read"),
        (["--trace", "generated:mars"], 1, "unknown trace 'mars'"),
        (["--to", "127.0.0.1:0"], 2, "--to 127.0.0.1:0: nothing listens on port 0; give the port of the server"),
        (["--listen", "8765"], 2, "--listen 8765: must be HOST:PORT"),
        (["--to", "http://127.0.0.1:8765"], 2, "--to http://127.0.0.1:8765: must be HOST:PORT"),
        (["--to", "a..b:8765"], 2, "must be HOST:PORT"),
        (["--trace", ""], 2, "trace is empty; give a name, or leave it out"),
        (["--listen", "127.0.0.1:99999"], 2, "must be HOST:PORT"),
        (["--delay-ms", "-5"], 2, "delay_ms = -5.0 must lie in"),
        (["--log", "/nowhere/at/all"], 2, "--log /nowhere/at/all: cannot be written"),
        (["--listen", "not-a-host.invalid:0"], 1, "not-a-host.invalid:0"),
        (["--listen", "192.0.2.1:0"], 1, "address); give an address of this machine"),
    ],
)
def test_wrong_use_is_one_line(capsys, arguments, code, says):
    assert main(arguments) == code
    out = capsys.readouterr()
    assert says in out.err
    assert out.err.count("\n") == 1
    assert out.out == ""


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT])
def test_the_command_says_when_it_is_ready_and_ends_cleanly(tmp_path, how):
    log = tmp_path / "log.jsonl"
    command = [sys.executable, "-m", "cags_shaper", "--trace", "generated:steady-30", "--json"]
    command += ["--start", "process", "--log", str(log)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        ready = json.loads(process.stdout.readline())
        assert ready["ready"] is True
        assert ready["port"] > 0
        while log.read_text().count("\n") < 3:
            time.sleep(0.02)
        process.send_signal(how)
        _, errors = process.communicate(timeout=20)
    assert process.returncode == 0
    assert errors == ""
    header, *rows = map(json.loads, log.read_text().splitlines())
    assert header["log"] == "cags-shaper"
    assert all(set(row) == set(header["fields"]) for row in rows)
    assert rows[0]["capacity_bytes"] > 0
