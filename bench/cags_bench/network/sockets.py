"""The load of :mod:`cags_bench.network.load` over real WebSockets and a real shaper, compared with virtual time.

No scene is rendered, so only the transport differs: kernel buffers, the event loop, the proxy.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Any

from cags_bench.demo.processes import ProcessGroup
from cags_bench.network.load import FPS, Arrivals, LoadClient, LoadServer, run_load
from cags_bench.network.sending import FALL_US, SETTLE_US, estimate_error, figures
from cags_bench.sim.world import Peer
from cags_common.errors import NetworkError
from cags_common.transport import ConnectionEndedError, Transport
from cags_common.transport.websocket import ServerWebSocket, connect
from cags_protocol.wire.limits import MAX_CLIENT_MESSAGE_BYTES, MAX_MESSAGE_BYTES, SUBPROTOCOL
from cags_server.link import MeasuredLink
from cags_shaper.link import Link, LinkSettings
from cags_shaper.trace import Trace, open_trace
from cags_shaper.tun import TunNames, run_behind, why_unavailable

TRACES = ("generated:steady-30", "generated:lte-driving", "generated:sawtooth")
FALL = "20 to 1.5 Mbps"

JOIN_US = 60_000_000
"""Longest start-up time of a client process."""

QUEUE_BYTES = 150_000
"""Queue of a packet link; packets beyond it are lost."""


def socket_lines(duration_us: int, delay_us: int) -> Iterator[dict[str, Any]]:
    """One line per trace, and one for a fall from 20 to 1.5 Mbps."""
    with tempfile.TemporaryDirectory(prefix="cags-network-") as folder:
        fall = Path(folder) / "fall.csv"
        seconds = FALL_US / 1e6
        fall.write_text(f"0,20\n{seconds},1.5\n{2 * seconds},1.5\n", encoding="ascii")
        for spec in TRACES:
            yield _compare(spec, spec, duration_us, SETTLE_US, delay_us)
        yield _compare(FALL, str(fall), 2 * FALL_US, FALL_US + SETTLE_US, delay_us)


def _compare(name: str, spec: str, duration_us: int, start_us: int, delay_us: int) -> dict[str, Any]:
    trace = open_trace(spec)
    virtual = run_load(trace, MeasuredLink(), duration_us, LinkSettings(delay_us=delay_us))
    real = asyncio.run(run_sockets(spec, duration_us, delay_us))
    totals = [sum(size for _, _, size in log.tiles) for log in (real, virtual)]
    return {
        "case": "sockets",
        "trace": name,
        "real_bytes": totals[0],
        "virtual_bytes": totals[1],
        "difference": abs(totals[0] - totals[1]) / max(totals[1], 1),
        **figures(real, trace, start_us, duration_us),
        "kernel_estimate_error": estimate_error(real.kernel, trace, start_us, duration_us),
        "virtual_latency_ms": figures(virtual, trace, start_us, duration_us)["latency_ms"],
    }


def kernel_bps(transport: ServerWebSocket) -> float | None:
    """TCP's own delivery rate; None if it is unknown or not yet measured."""
    info = transport.tcp_info()
    return info.delivery_rate_bps if info is not None and info.delivery_rate_bps > 0 else None


@contextlib.asynccontextmanager
async def serving(host: str, log: Arrivals, clock: Callable[[], int], duration_us: int) -> AsyncIterator[int]:
    """Run the load's server; yields its port."""
    from aiohttp import web

    async def stream(request: web.Request) -> web.StreamResponse:
        transport = await ServerWebSocket.accept(
            request, subprotocol=SUBPROTOCOL, max_message_bytes=MAX_CLIENT_MESSAGE_BYTES
        )
        server = LoadServer(MeasuredLink(), log, FPS, lambda: kernel_bps(transport))
        await drive(server, transport, clock, duration_us)
        return transport.response

    app = web.Application()
    app.router.add_get("/stream", stream)
    runner = web.AppRunner(app, access_log=None)
    await runner.setup()
    try:
        await web.TCPSite(runner, host, 0).start()
        yield int(runner.addresses[0][1])
    finally:
        await runner.cleanup()


async def run_sockets(spec: str, duration_us: int, delay_us: int) -> Arrivals:
    """One session in real time, with the shaper in its own process."""
    log = Arrivals()
    start_ns = time.monotonic_ns()

    def clock() -> int:
        return (time.monotonic_ns() - start_ns) // 1000

    with tempfile.TemporaryDirectory(prefix="cags-network-") as folder, ProcessGroup(Path(folder)) as group:
        async with serving("127.0.0.1", log, clock, duration_us) as port:
            flags = ["--listen", "127.0.0.1:0", "--to", f"127.0.0.1:{port}", "--trace", spec, "--json"]
            flags += ["--delay-ms", str(delay_us / 1e3)]
            ready = await asyncio.to_thread(group.start("cags_shaper", flags).ready)
            url = f"ws://127.0.0.1:{ready['port']}/stream"
            start_ns = time.monotonic_ns()  # the shaper's link begins with this connection
            transport = await connect(url, subprotocol=SUBPROTOCOL, max_message_bytes=MAX_MESSAGE_BYTES)
            await drive(LoadClient(log), transport, clock, duration_us)
            await transport.close()
    return log


def direct_lines(duration_us: int, delay_us: int) -> Iterator[dict[str, Any]]:
    """One line per trace: estimates from acknowledgements and from TCP itself, over a path without a proxy.

    The link carries packets (TUN devices: Linux, root), so the connection is end to end.
    """
    reason = why_unavailable()
    if reason is not None:
        yield {"case": "direct", "skipped": reason}
        return
    for spec in TRACES:
        trace = open_trace(spec)
        log = asyncio.run(run_direct(trace, duration_us, delay_us))
        start_us, end_us = log.estimates[0][0] + SETTLE_US, log.estimates[-1][0]
        yield {
            "case": "direct",
            "trace": spec,
            "estimate_error": estimate_error(log.estimates, trace, start_us, end_us),
            "kernel_estimate_error": estimate_error(log.kernel, trace, start_us, end_us),
        }


async def run_direct(trace: Trace, duration_us: int, delay_us: int) -> Arrivals:
    """One session of ``duration_us`` with the client behind a packet link; returns the server's record.

    The client ends the session, so its start-up time does not shorten it.
    """
    log, names = Arrivals(), TunNames(os.getpid())
    start_ns = time.monotonic_ns()
    async with serving("0.0.0.0", log, lambda: (time.monotonic_ns() - start_ns) // 1000, JOIN_US + duration_us) as port:  # noqa: S104
        url = f"ws://{names.addresses[0]}:{port}/stream"
        command = [sys.executable, "-m", "cags_bench.network.load_client", url, str(duration_us / 1e6)]
        settings = LinkSettings(delay_us=delay_us, queue_bytes=QUEUE_BYTES)
        start_ns = time.monotonic_ns()  # the link begins with the command
        status = await run_behind(command, names, Link(trace, settings), Link(None, settings))
    if status != 0:
        raise NetworkError(f"the load's client failed with exit status {status}")
    return log


async def drive(peer: Peer, transport: Transport, clock: Any, until_us: int) -> None:
    """Transfer a peer's messages until ``until_us`` or the end of the connection."""
    wake = asyncio.Event()

    async def read() -> None:
        while True:
            peer.receive(await transport.recv(), clock())
            wake.set()

    async def write() -> None:
        while clock() < until_us:
            wake.clear()
            now_us = clock()
            timer_us = peer.next_timer_us()
            if timer_us is not None and timer_us <= now_us:
                peer.handle_timer(now_us)
            for data in peer.data_to_send(now_us):
                await transport.send(data)
            timer_us = peer.next_timer_us()
            next_us = until_us if timer_us is None else min(timer_us, until_us)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(max(next_us - clock(), 0) / 1e6):
                    await wake.wait()

    tasks = [asyncio.create_task(part()) for part in (read, write)]
    await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    for task in tasks:
        task.cancel()
    for result in await asyncio.gather(*tasks, return_exceptions=True):
        if isinstance(result, Exception) and not isinstance(result, ConnectionEndedError):
            raise result
