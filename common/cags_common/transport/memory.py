"""A transport within one process, for tests and examples: two ends of bounded queues."""

from __future__ import annotations

import asyncio

from cags_common.transport.base import ConnectionEndedError

MAX_WAITING = 64
"""Messages that wait at most; a sender beyond that waits too."""


class MemoryTransport:
    """One end of :func:`memory_pair`."""

    peer = "memory"

    def __init__(self, inbox: asyncio.Queue[bytes | None], outbox: asyncio.Queue[bytes | None]) -> None:
        self._inbox, self._outbox = inbox, outbox
        self._ended = False

    async def send(self, data: bytes) -> None:
        """See :class:`Transport`."""
        if self._ended:
            raise ConnectionEndedError("memory: the connection is closed")
        await self._outbox.put(data)

    async def recv(self) -> bytes:
        """See :class:`Transport`."""
        data = None if self._ended else await self._inbox.get()
        if data is None:
            self._ended = True
            raise ConnectionEndedError("memory: the peer closed the connection")
        return data

    async def close(self, reason: str = "") -> None:
        """See :class:`Transport`."""
        if not self._ended:
            self._ended = True
            await self._outbox.put(None)

    def abort(self) -> None:
        """See :class:`Transport`."""
        self._ended = True
        while not self._outbox.empty():
            self._outbox.get_nowait()
        self._outbox.put_nowait(None)


def memory_pair() -> tuple[MemoryTransport, MemoryTransport]:
    """Two ends of one connection."""
    a: asyncio.Queue[bytes | None] = asyncio.Queue(MAX_WAITING)
    b: asyncio.Queue[bytes | None] = asyncio.Queue(MAX_WAITING)
    return MemoryTransport(a, b), MemoryTransport(b, a)
