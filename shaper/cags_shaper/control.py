"""Live control of a running shaper: one JSON object a line in, one a line out, on a TCP port.

    {}                                         asks
    {"cap_mbps": 5.0, "delay_ms": 40.0}        sets; what is missing stays, "cap_mbps": null takes the cap away
    {"ok": true, "cap_mbps": 5.0, "delay_ms": 40.0, "capacity_mbps": 5.0, "delivered_mbps": 4.7, "queue_bytes": 9000}
    {"ok": false, "error": "..."}

Capacity, delivered rate (over the last second) and queue are those of the direction towards the client; a cap and a
delay hold for both.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
from collections import deque
from typing import Any

from cags_common.errors import CagsError, ConfigError
from cags_common.runtime.tasks import watched
from cags_shaper.proxy import bound_socket
from cags_shaper.shaped import Shaped

log = logging.getLogger("cags_shaper")

MAX_LINE_BYTES = 4096
RATE_WINDOW_US = 1_000_000
RATE_STEP_S = 0.1


class ControlPort:
    """Answers control lines for one link of two directions."""

    def __init__(self, shaped: Shaped) -> None:
        self._shaped = shaped
        self._samples: deque[tuple[int, int]] = deque([(0, 0)])  # (time, bytes delivered until then)
        self._tasks: set[asyncio.Task[None]] = set()

    async def start(self, host: str, port: int) -> tuple[str, int]:
        """Listen; the address in use. Raises :class:`NetworkError`."""
        listener = bound_socket("control", host, port)
        listener.listen(8)
        self._server = await asyncio.start_server(self._accept, sock=listener, limit=MAX_LINE_BYTES)
        self._spawn(self._sample())
        name = listener.getsockname()
        return str(name[0]), int(name[1])

    async def close(self) -> None:
        """Stop listening and hang up."""
        self._server.close()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def answer(self, line: bytes) -> dict[str, Any]:
        """What one line gets back; a wrong one changes nothing."""
        try:
            self._change(_parse(line))
        except CagsError as error:
            return {"ok": False, "error": str(error)}
        return {"ok": True, **self._state()}

    def _change(self, wanted: dict[str, Any]) -> None:
        settings: dict[str, Any] = {}
        if "cap_mbps" in wanted:
            cap = wanted["cap_mbps"]
            settings["cap_bps"] = None if cap is None else cap * 1e6
        if "delay_ms" in wanted:
            settings["delay_us"] = round(wanted["delay_ms"] * 1e3)
        for direction in (self._shaped.downlink, self._shaped.uplink):
            direction.link.change(**settings)

    def _state(self) -> dict[str, Any]:
        direction = self._shaped.downlink
        link, now_us = direction.link, direction.now_us()
        allowed_bps = link.capacity_bps(now_us, now_us + RATE_WINDOW_US)
        start_us, start_bytes = self._samples[0]
        elapsed_us = max(now_us - start_us, 1)
        return {
            "cap_mbps": None if link.settings.cap_bps is None else link.settings.cap_bps / 1e6,
            "delay_ms": link.settings.delay_us / 1e3,
            "capacity_mbps": None if allowed_bps is None else allowed_bps / 1e6,
            "delivered_mbps": (link.counts.delivered_bytes - start_bytes) * 8 / elapsed_us,
            "queue_bytes": link.queued_bytes(now_us),
        }

    async def _sample(self) -> None:
        while True:
            await asyncio.sleep(RATE_STEP_S)
            if not self._shaped.downlink.clock.begun:
                continue
            now_us = self._shaped.downlink.now_us()
            self._samples.append((now_us, self._shaped.downlink.link.counts.delivered_bytes))
            while self._samples[0][0] < now_us - RATE_WINDOW_US:
                self._samples.popleft()

    def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._spawn(self._converse(reader, writer))

    async def _converse(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            with contextlib.suppress(OSError):
                while line := await _line(reader):
                    writer.write(json.dumps(self.answer(line)).encode() + b"\n")
                    await writer.drain()
        finally:
            writer.close()

    def _spawn(self, coroutine: Any) -> None:
        task = watched(coroutine, lambda error: log.error("control port: %s", error, exc_info=error))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


async def _line(reader: asyncio.StreamReader) -> bytes:
    """The next line; one that is too long ends the conversation."""
    try:
        return await reader.readline()
    except ValueError:
        return b""


def _parse(line: bytes) -> dict[str, Any]:
    try:
        wanted = json.loads(line)
    except (ValueError, RecursionError) as error:  # not JSON, not UTF-8, or lists in lists in lists
        raise ConfigError(f"not a JSON object ({error})") from error
    if not isinstance(wanted, dict):
        raise ConfigError("not a JSON object")
    unknown = sorted(set(wanted) - {"cap_mbps", "delay_ms"})
    if unknown:
        raise ConfigError(f"unknown key {unknown[0]!r}; known: cap_mbps, delay_ms")
    for name, low, high in (("cap_mbps", 0.001, 1e6), ("delay_ms", 0.0, 60_000.0)):
        if name not in wanted or (wanted[name] is None and name == "cap_mbps"):
            continue
        value = wanted[name]
        if type(value) not in (int, float) or not low <= value <= high:
            raise ConfigError(f"{name} = {value!r:.40} must be a number in [{low:g}, {high:g}]")
    return wanted
