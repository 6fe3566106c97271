"""The line to a shaper's control port: its cap and delay from the page, its capacity for the plot."""

from __future__ import annotations

import asyncio
import contextlib
import json
from typing import Any

from cags_common.errors import ConfigError, NetworkError
from cags_common.transport.hosts import is_host

TIMEOUT_S = 2.0
MAX_LINE_BYTES = 4096


class ShaperControl:
    """Asks one JSON line, reads one JSON line; connects again when the line went dead."""

    def __init__(self, address: str) -> None:
        """``address`` is HOST:PORT. Raises :class:`ConfigError`."""
        host, _, port = address.rpartition(":")
        self._host = host.strip("[]")
        if not is_host(self._host) or not port.isdecimal() or not 0 < int(port) < 65536:
            raise ConfigError(f"shaper_control = {address!r} must be HOST:PORT")
        self._port = int(port)
        self._line: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None
        self._turn = asyncio.Lock()

    async def ask(self, **changes: float | None) -> dict[str, Any]:
        """Change what is named, and return the shaper's state. Raises :class:`NetworkError`."""
        async with self._turn:
            try:
                async with asyncio.timeout(TIMEOUT_S):
                    answer = await self._exchange(json.dumps(changes).encode() + b"\n")
            except (OSError, TimeoutError, asyncio.LimitOverrunError, ValueError) as error:
                await self.close()
                raise NetworkError(f"shaper control {self._host}:{self._port} does not answer ({error})") from error
        if not answer.get("ok"):
            raise NetworkError(f"shaper control refused: {answer.get('error', 'no reason given')}")
        return answer

    async def _exchange(self, request: bytes) -> dict[str, Any]:
        if self._line is None:
            self._line = await asyncio.open_connection(self._host, self._port, limit=MAX_LINE_BYTES)
        reader, writer = self._line
        writer.write(request)
        await writer.drain()
        line = await reader.readuntil(b"\n")
        answer = json.loads(line)
        if not isinstance(answer, dict):
            raise ValueError("the answer is not a JSON object")
        return answer

    async def close(self) -> None:
        """Hang up."""
        if self._line is not None:
            writer = self._line[1]
            self._line = None
            writer.close()
            with contextlib.suppress(OSError):
                await writer.wait_closed()
