"""A relay between a client and a server whose link can stall: it goes on existing, and carries nothing."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager


class Relay:
    """Carries bytes until :meth:`stall`; then it neither reads nor writes, and answers nothing but TCP itself."""

    def __init__(self, to: int) -> None:
        self._to = to
        self._flows = threading.Event()
        self._flows.set()
        self._loop = asyncio.new_event_loop()
        listener = socket.create_server(("127.0.0.1", 0))
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        self.port = int(listener.getsockname()[1])
        self._listener = listener
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def stall(self) -> None:
        """Carry nothing from now on, for connections there are and those to come."""
        self._flows.clear()

    def resume(self) -> None:
        """Carry again."""
        self._flows.set()

    def close(self) -> None:
        """Hang up."""
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(5)
        self._loop.close()

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._loop.run_until_complete(self._serve())

    async def _serve(self) -> None:
        self._stop = asyncio.Event()
        server = await asyncio.start_server(self._relay, sock=self._listener, limit=4096)
        await self._stop.wait()
        server.close()
        for task in asyncio.all_tasks() - {asyncio.current_task()}:
            task.cancel()
        await asyncio.sleep(0.05)

    async def _relay(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError, asyncio.CancelledError):
            up_reader, up_writer = await asyncio.open_connection("127.0.0.1", self._to, limit=4096)
            try:
                await asyncio.gather(self._carry(reader, up_writer), self._carry(up_reader, writer))
            finally:
                up_writer.transport.abort()
                writer.transport.abort()

    async def _carry(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while True:
            while not self._flows.is_set():  # noqa: ASYNC110
                await asyncio.sleep(0.01)
            data = await reader.read(4096)
            if not data:
                writer.close()
                return
            while not self._flows.is_set():  # noqa: ASYNC110
                await asyncio.sleep(0.01)
            writer.write(data)
            await writer.drain()


@contextmanager
def relay(to: int) -> Iterator[Relay]:
    """A relay to a port of this machine."""
    made = Relay(to)
    try:
        yield made
    finally:
        made.close()
