"""The running shaper: proxy, control port and log, from a ready line to a signal."""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
import time
from typing import TYPE_CHECKING

from cags_common.errors import NetworkError
from cags_common.runtime.tasks import watched
from cags_common.transport.hosts import host_port
from cags_shaper.control import ControlPort
from cags_shaper.link import Link
from cags_shaper.log import LogWriter, close_log, open_log
from cags_shaper.proxy import Piece, ShaperProxy

if TYPE_CHECKING:
    from cags_shaper.settings import ShaperSettings
    from cags_shaper.trace import Trace


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
            log = open_log(self._settings.log) if self._settings.log else None
            if log is not None:
                stack.callback(close_log, log)
            ready = await self._start(stack)
            for number in (signal.SIGTERM, signal.SIGINT):
                asyncio.get_running_loop().add_signal_handler(number, stop.set)
            print(self._ready_line(ready), flush=True)
            watching = watched(self._end_with_proxy(stop), lambda error: None)  # raised below
            if log is not None:
                await LogWriter(log, self._settings).follow(self._proxy, stop)
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
        address, control_address = self._settings.address("listen"), self._settings.address("control")
        assert address is not None
        host, port = await self._proxy.start(*address, lambda: time.monotonic_ns() // 1000)
        stack.push_async_callback(self._proxy.close)
        if self._settings.start == "process":
            self._proxy.begin()
        ready: dict[str, str | int] = {"host": host, "port": port}
        if control_address is not None:
            control = ControlPort(self._proxy)
            _, ready["control"] = await control.start(*control_address)
            stack.push_async_callback(control.close)
        return ready

    def _ready_line(self, ready: dict[str, str | int]) -> str:
        if self._as_json:
            return json.dumps({"ready": True, **ready})
        control = f", control on port {ready['control']}" if "control" in ready else ""
        return f"listening on {host_port(str(ready['host']), int(ready['port']))}{control}"
