"""A TCP proxy with one link per direction, shared by all connections like a real bottleneck.

A stream cannot lose bytes, so a full queue blocks instead of dropping: the proxy stops reading and the sender's window
closes. Kernel buffers are kept small, because they would act as a second queue.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import os
import socket
from collections.abc import Callable
from dataclasses import dataclass

from cags_common.errors import NetworkError
from cags_common.runtime.rare_log import RareLog
from cags_common.runtime.tasks import watched
from cags_common.runtime.wake import woken
from cags_common.transport.accepting import accept_all
from cags_shaper.link import SEGMENT_BYTES, Link, tcp_wire_bytes
from cags_shaper.link_clock import LinkClock

log = logging.getLogger("cags_shaper")

RECEIVE_BUFFER_BYTES = 32 * 1024
"""Kernel receive buffer of a shaped connection (Linux doubles it)."""

WRITE_BACKLOG_BYTES = 256 * 1024
"""Delivered bytes that a receiver may leave unread before its sender is blocked."""

READ_BYTES = 16 * SEGMENT_BYTES

MAX_CONNECTIONS = 400
"""Largest number of connections; each takes two descriptors of the usual 1,024. A further one replaces the oldest."""


@dataclass(frozen=True)
class Piece:
    """Bytes on their way to ``to``; empty: the end of the stream, whose delivery sets ``ended``."""

    data: bytes
    to: asyncio.StreamWriter
    ended: asyncio.Event | None = None


class ShapedDirection:
    """One link and the task that delivers its output."""

    def __init__(
        self, link: Link[Piece], clock: LinkClock, on_fault: Callable[[BaseException], None] | None = None
    ) -> None:
        """``on_fault`` is called if delivery ends by itself, because every connection hangs then."""
        self.link, self.clock = link, clock
        self._wake = asyncio.Event()
        self._room = asyncio.Event()
        self._task = watched(self._deliver(), on_fault or _log_fault)

    def now_us(self) -> int:
        """Time since the start of the link."""
        return self.clock.now_us()

    async def carry(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Send one connection's stream through the link until its end has been delivered."""
        with contextlib.suppress(OSError):  # a reset or a time-out is an end; data in flight still arrives
            while data := await reader.read(READ_BYTES):
                for start in range(0, len(data), SEGMENT_BYTES):
                    await self._push(Piece(data[start : start + SEGMENT_BYTES], writer))
                await writer.drain()
        ended = asyncio.Event()
        await self._push(Piece(b"", writer, ended))
        await ended.wait()

    async def close(self) -> None:
        """Stop delivering."""
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)

    async def _push(self, piece: Piece) -> None:
        size = tcp_wire_bytes(len(piece.data)) if piece.data else 1
        while not self.link.push(self.now_us(), piece, size):
            self._room.clear()
            await self._room.wait()
        self._wake.set()

    async def _deliver(self) -> None:
        while True:
            self._wake.clear()
            now = self.now_us()
            for piece in self.link.pop_due(now):
                _write(piece)
            self.link.queued_bytes(now)  # packets that have left the queue need no further wake-up
            self._room.set()
            await self._sleep()

    async def _sleep(self) -> None:
        """Wait until the link can deliver, has room, or receives something."""
        times = [t for t in (self.link.next_delivery_us(), self.link.next_room_us()) if t is not None]
        await woken(self._wake, None if not times else (min(times) - self.now_us()) / 1e6)


def _write(piece: Piece) -> None:
    if piece.ended is not None:
        piece.ended.set()
    if piece.to.is_closing():
        return
    try:
        if piece.data:
            piece.to.write(piece.data)
        elif piece.to.can_write_eof():
            piece.to.write_eof()
    except OSError:  # reset by its peer, which a transport that is not reading has yet to notice
        piece.to.transport.abort()


def _log_fault(error: BaseException) -> None:
    log.error("the link has stopped: %s", error, exc_info=error)


class ShaperProxy:
    """Listens, connects each client to the target, and carries both directions through their links.

    The links' time, and thus their traces, begin with the first connection, so that the conditions do not depend on how
    long the proxy has waited. :meth:`begin` starts them earlier.
    """

    def __init__(self, target: tuple[str, int], downlink: Link[Piece], uplink: Link[Piece]) -> None:
        self._target, self._told = target, RareLog(log)
        self._links = downlink, uplink
        self._connections: dict[asyncio.Task[None], None] = {}  # oldest first
        self._listener: socket.socket | None = None
        self._accepting: asyncio.Task[None] | None = None
        self._stopped: asyncio.Future[None] | None = None

    async def start(self, host: str, port: int, clock: Callable[[], int]) -> tuple[str, int]:
        """Start listening; the address in use (``port`` 0 picks a free one). Raises :class:`NetworkError`."""
        listener = bound_socket("listen", host, port)
        _make_small(listener)  # before listening: connections inherit it
        listener.listen(128)
        self._clock = LinkClock(clock)
        self._stopped = asyncio.get_running_loop().create_future()
        self.downlink, self.uplink = (ShapedDirection(link, self._clock, self._stop) for link in self._links)
        self._listener = listener
        accepting = accept_all(listener, self._accept, log, relieve=self._end_oldest)
        self._accepting = watched(accepting, self._stop)
        name = listener.getsockname()
        return str(name[0]), int(name[1])

    def begin(self) -> None:
        """Start the links' time, unless it has started."""
        self._clock.begin()

    async def stopped(self) -> None:
        """Waits for a fault that ends the service of every connection, and raises it."""
        assert self._stopped is not None, "start comes first"
        await asyncio.shield(self._stopped)

    async def close(self) -> None:
        """Stop listening and hang up all connections."""
        if self._accepting is None or self._listener is None or self._stopped is None:
            return
        self._stopped.cancel()
        self._accepting.cancel()
        await asyncio.gather(self._accepting, return_exceptions=True)
        self._listener.close()
        for task in list(self._connections):
            task.cancel()
        await asyncio.gather(*self._connections, return_exceptions=True)
        await asyncio.gather(self.downlink.close(), self.uplink.close())

    def _stop(self, error: BaseException) -> None:
        _log_fault(error)
        if self._stopped is not None and not self._stopped.done():
            self._stopped.set_exception(error)
            self._stopped.exception()  # told by the line above, whether or not somebody waits

    def _accept(self, accepted: socket.socket) -> None:
        self.begin()
        if len(self._connections) >= MAX_CONNECTIONS:
            self._end_oldest()
        # A task of our own: asyncio's would report our cancelling it as an error.
        task = watched(self._carry_both(accepted), _log_fault)
        self._connections[task] = None
        task.add_done_callback(self._left)

    def _left(self, task: asyncio.Task[None]) -> None:
        self._connections.pop(task, None)

    def _end_oldest(self) -> None:
        oldest = next(iter(self._connections), None)
        if oldest is not None:
            oldest.cancel()
            del self._connections[oldest]

    async def _carry_both(self, accepted: socket.socket) -> None:
        try:
            reader, writer = await asyncio.open_connection(sock=accepted, limit=READ_BYTES)
        except BaseException:
            accepted.close()
            raise
        try:
            await self._connect(reader, writer)
        except OSError as error:
            self._told.write(
                logging.WARNING, "target", "connection to %s:%d: %s", *self._target, error.strerror or error
            )
        except asyncio.CancelledError:
            writer.transport.abort()
            raise
        finally:
            writer.close()

    async def _connect(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            upstream = await _dial(*self._target)
        except OSError as error:
            told = "%s:%d: no server answers (%s); start cags-server there, or give its address by --to"
            self._told.write(logging.WARNING, "target", told, *self._target, _reason(error))
            return
        up_reader, up_writer = await asyncio.open_connection(sock=upstream, limit=READ_BYTES)
        for side in (writer, up_writer):
            side.transport.set_write_buffer_limits(high=WRITE_BACKLOG_BYTES)
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self.uplink.carry(reader, up_writer))
                group.create_task(self.downlink.carry(up_reader, writer))
        except asyncio.CancelledError:
            up_writer.transport.abort()
            raise
        finally:
            up_writer.close()


def bound_socket(flag: str, host: str, port: int) -> socket.socket:
    """A socket bound to an address that the user gave by ``--flag``. Raises :class:`NetworkError`."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        bound = socket.socket(family, kind, protocol)
    except OSError as error:
        raise NetworkError(
            f"--{flag} {host}:{port}: {error.strerror or error}; give an address of this machine"
        ) from error
    try:
        bound.setblocking(False)
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind(address)
    except OSError as error:
        bound.close()
        reason = "is in use" if error.errno == errno.EADDRINUSE else f"cannot be used ({error.strerror})"
        way_out = "give another port, or 0 for a free one"
        if error.errno == errno.EADDRNOTAVAIL:
            way_out = "give an address of this machine"
        raise NetworkError(f"--{flag} {host}:{port} {reason}; {way_out}") from error
    return bound


def _reason(error: OSError) -> str:
    """In the system's words: asyncio's repeat the address."""
    if error.errno is not None and error.errno > 0:  # that of a name that is not found is negative
        return os.strerror(error.errno)
    return error.strerror or str(error)


async def _dial(host: str, port: int) -> socket.socket:
    loop = asyncio.get_running_loop()
    family, kind, protocol, _, address = (await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM))[0]
    upstream = socket.socket(family, kind, protocol)
    try:
        _make_small(upstream)
        upstream.setblocking(False)
        await loop.sock_connect(upstream, address)
    except BaseException:
        upstream.close()
        raise
    return upstream


def _make_small(sock: socket.socket) -> None:
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_MAXSEG, SEGMENT_BYTES)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
