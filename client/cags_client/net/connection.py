"""One connection as the real-time shell uses it: writing never waits for the link.

A link that stalls without a reset takes nothing and says nothing. Whoever awaits a ``send`` on it neither reads, draws
nor ends until the kernel gives up, a quarter of an hour later.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterable

from cags_common.errors import NetworkError
from cags_common.runtime.tasks import watched
from cags_common.transport import Transport

MAX_UNSENT_BYTES = 512 * 1024
"""What waits for a link that takes nothing: poses and acknowledgements of about a minute."""

FAREWELL_S = 0.3
"""How long an end that is asked for waits for the last words to be written, and again for an end in order."""

LEISURELY_S = 3.0
"""The same where nobody waits for the end: a busy server reads the last words later, and would lose them with a
connection that is ended by force (its own next write meets the reset first)."""


class Connection:
    """A transport, and what is still to be written to it."""

    def __init__(self, transport: Transport, on_lost: Callable[[Connection, str], None]) -> None:
        """``on_lost`` hears, with this connection and the reason, of an end while it is written to."""
        self.transport = transport
        self._on_lost = on_lost
        self._unsent: deque[bytes] = deque()
        self._unsent_bytes = 0
        self._more, self._empty = asyncio.Event(), asyncio.Event()
        self._empty.set()
        self._hurried: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._lost = False
        self._writing = watched(self._write(), lambda error: self._end(str(error)))

    def send(self, messages: Iterable[bytes]) -> None:
        """Have ``messages`` written, as fast as the link takes them; they are for nobody once it has ended."""
        if self._lost:
            return
        for data in messages:
            self._unsent.append(data)
            self._unsent_bytes += len(data)
            self._empty.clear()
            self._more.set()
        if self._unsent_bytes > MAX_UNSENT_BYTES:
            self._end("the link takes nothing any more")

    async def close(self, farewell_s: float = FAREWELL_S) -> None:
        """Write what is left, and end the connection; by force where the link does not take part.

        It waits ``farewell_s`` seconds twice at most, or until :meth:`hurry`.
        """
        try:
            async with asyncio.timeout(farewell_s):
                if not self._lost:
                    await self._empty.wait()
        except TimeoutError:
            pass
        finally:
            self._writing.cancel()
            await asyncio.gather(self._writing, return_exceptions=True)
        closing = asyncio.ensure_future(self.transport.close())
        await asyncio.wait([closing, self._hurried], timeout=farewell_s, return_when=asyncio.FIRST_COMPLETED)
        if not closing.done():
            self.transport.abort()
            closing.cancel()
        await asyncio.gather(closing, return_exceptions=True)

    def hurry(self) -> None:
        """Whoever closes this connection waits no longer."""
        if not self._hurried.done():
            self._hurried.set_result(None)
        self._empty.set()

    async def _write(self) -> None:
        while True:
            self._more.clear()
            while self._unsent:
                data = self._unsent.popleft()
                try:
                    await self.transport.send(data)
                except NetworkError as error:
                    self._end(str(error))
                    return
                self._unsent_bytes -= len(data)
            self._empty.set()
            await self._more.wait()

    def _end(self, reason: str) -> None:
        self._unsent.clear()
        self._unsent_bytes = 0
        self._empty.set()
        if not self._lost:
            self._lost = True
            self._on_lost(self, reason)
