"""The running shaper: what carries (the proxy, or packets of a command) with its control port and log."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import sys
import time
from collections.abc import AsyncIterator, Sequence
from typing import TYPE_CHECKING

from cags_common.errors import NetworkError
from cags_common.runtime.endings import on_first_request
from cags_common.runtime.tasks import watched
from cags_common.transport.hosts import host_port
from cags_shaper.control import ControlPort
from cags_shaper.link import Link
from cags_shaper.log import LogWriter, close_log, open_log
from cags_shaper.proxy import Piece, ShaperProxy

if TYPE_CHECKING:
    from cags_shaper.settings import ShaperSettings
    from cags_shaper.shaped import Shaped
    from cags_shaper.trace import Trace
    from cags_shaper.tun import PacketPair

LOG = logging.getLogger("cags_shaper")


class Service:
    """One ``cags-shaper`` process. ``traces`` are those towards the client and towards the server."""

    def __init__(self, settings: ShaperSettings, traces: list[Trace | None], as_json: bool) -> None:
        self._settings, self._as_json = settings, as_json
        target = settings.address("to")
        assert target is not None
        down: Link[Piece] = Link(traces[0], settings.link())
        up: Link[Piece] = Link(traces[1], settings.link())
        self._proxy = ShaperProxy(target, down, up)

    async def run(self) -> None:
        """Shape until SIGTERM or SIGINT. Raises :class:`CagsError` before the ready line, not after."""
        stop = asyncio.Event()
        async with contextlib.AsyncExitStack() as stack:
            ready = await self._start(stack)
            on_first_request(lambda _: stop.set())
            print(self._ready_line(ready), flush=True)
            watching = watched(self._end_with_proxy(stop), lambda error: None)  # raised below
            await stop.wait()
            if watching.done():
                await watching
            watching.cancel()

    async def _end_with_proxy(self, stop: asyncio.Event) -> None:
        try:
            await self._proxy.stopped()
        except Exception as error:
            raise NetworkError(f"the link has stopped ({error}); start the shaper again") from error
        finally:
            stop.set()

    async def _start(self, stack: contextlib.AsyncExitStack) -> dict[str, str | int]:
        address = self._settings.address("listen")
        assert address is not None
        host, port = await self._proxy.start(*address, lambda: time.monotonic_ns() // 1000)
        stack.push_async_callback(self._proxy.close)
        if self._settings.start == "process":
            self._proxy.begin()
        ready: dict[str, str | int] = {"host": host, "port": port}
        control = await stack.enter_async_context(_instruments(self._settings, self._proxy))
        return ready if control is None else {**ready, "control": control}

    def _ready_line(self, ready: dict[str, str | int]) -> str:
        if self._as_json:
            return json.dumps({"ready": True, **ready})
        control = f", control on port {ready['control']}" if "control" in ready else ""
        return f"listening on {host_port(str(ready['host']), int(ready['port']))}{control}"


async def run_packets(settings: ShaperSettings, traces: list[Trace | None], command: Sequence[str]) -> int:
    """Run ``command`` behind packets' links; its exit status. Raises :class:`ConfigError` and :class:`NetworkError`.

    Standard output is the command's, so the control port is told on standard error.
    """
    from cags_shaper.tun import TunNames, run_behind  # only where there are TUN devices

    down: Link[bytes] = Link(traces[0], settings.link())
    up: Link[bytes] = Link(traces[1], settings.link())

    @contextlib.asynccontextmanager
    async def beside(pair: PacketPair) -> AsyncIterator[None]:
        async with _instruments(settings, pair) as control:
            if control is not None:
                print(f"cags-shaper: control on port {control}", file=sys.stderr, flush=True)
            yield

    return await run_behind(command, TunNames(os.getpid()), down, up, beside)


@contextlib.asynccontextmanager
async def _instruments(settings: ShaperSettings, shaped: Shaped) -> AsyncIterator[int | None]:
    """Log and control port of ``shaped``, as far as the settings want them; yields the control port in use.

    Raises :class:`ConfigError` and :class:`NetworkError`.
    """
    async with contextlib.AsyncExitStack() as stack:
        if settings.log:
            log = open_log(settings.log)
            stack.callback(close_log, log)
            await stack.enter_async_context(_logged(LogWriter(log, settings), shaped))
        port: int | None = None
        if (address := settings.address("control")) is not None:
            control = ControlPort(shaped)
            _, port = await control.start(*address)
            stack.push_async_callback(control.close)
        yield port


@contextlib.asynccontextmanager
async def _logged(writer: LogWriter, shaped: Shaped) -> AsyncIterator[None]:
    """Write samples, and a last one at the end."""
    over = asyncio.Event()
    following = watched(writer.follow(shaped, over), lambda error: LOG.error("the log has ended: %s", error))
    try:
        yield
    finally:
        over.set()
        await asyncio.gather(following, return_exceptions=True)
