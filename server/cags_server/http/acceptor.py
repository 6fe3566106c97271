"""The server's front door: raw connections, before any of them has shown who it is.

Connections that have yet to finish a request, or a TLS handshake, cost an attacker nothing. They are bounded in number
and time; one too many ends the oldest one of the address that has most of them. So whoever asks at once gets in,
however many do not. A WebSocket waits in the same way until its Hello, unless its request showed the token
(:class:`~cags_server.http.app.App` counts those).
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import ssl
from collections.abc import Callable
from typing import Any

from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError
from aiohttp.typedefs import Handler, Middleware
from aiohttp.web_protocol import RequestHandler

from cags_common.runtime.rare_log import RareLog
from cags_common.runtime.tasks import watched
from cags_common.transport.accepting import accept_all
from cags_server.http.waiting_list import WaitingList

HEADER_S = 5.0
"""Time for a TLS handshake and a whole request header, and between two requests of a connection."""

ANSWER_S = 30.0
"""Time to take an answer, other than a stream."""

MAX_WAITING = 256
"""Connections that may be at it at once."""

BACKLOG = 128
"""Connections that the kernel holds until they are accepted."""

SWEEP_S = 0.25

log = logging.getLogger(__name__)


class Visitor:
    """One raw connection."""

    def __init__(self, accepted: socket.socket, peer: str) -> None:
        self.peer = peer
        self.arriving: asyncio.Task[None] | None = None
        self.handler: RequestHandler | None = None
        self._socket = accepted

    def cut(self) -> None:
        """End it at once."""
        transport = None if self.handler is None else self.handler.transport
        if transport is not None:
            transport.abort()
        elif self.arriving is not None and not self.arriving.done():
            self.arriving.cancel()
        else:
            self._socket.close()


class _Handler(RequestHandler):
    """aiohttp's protocol of one connection, which tells the acceptor of its end."""

    def __init__(
        self,
        *arguments: Any,
        on_lost: Callable[[], None],
        on_nonsense: Callable[[BaseException], None],
        **options: Any,
    ) -> None:
        super().__init__(*arguments, **options)
        self._on_lost, self._on_nonsense = on_lost, on_nonsense

    def log_exception(self, *args: Any, **kw: Any) -> None:
        """A request that is none is no fault of ours, and no reason for a traceback."""
        error = kw.get("exc_info")
        if isinstance(error, HttpProcessingError):
            self._on_nonsense(error)
        else:
            super().log_exception(*args, **kw)

    def connection_lost(self, exc: BaseException | None) -> None:
        super().connection_lost(exc)
        self._on_lost()


class Acceptor:
    """Accepts connections and gives them to aiohttp."""

    def __init__(self, max_connections: int, max_waiting: int = MAX_WAITING) -> None:
        self._max_connections, self._max_waiting = max_connections, min(max_waiting, max_connections)
        self._visitors: dict[Visitor, None] = {}
        self._waiting, self._answered = WaitingList[Visitor](), WaitingList[Visitor]()
        self._by_handler: dict[Any, Visitor] = {}
        self._told = RareLog(log)
        self._tasks: list[asyncio.Task[None]] = []
        self._listeners: list[socket.socket] = []

    def __len__(self) -> int:
        return len(self._visitors)

    @property
    def waiting(self) -> int:
        """Connections that have yet to ask for something."""
        return len(self._waiting)

    def middleware(self) -> Middleware:
        """For the application that answers: a request has come, and is done with."""

        @web.middleware
        async def middleware(request: web.Request, handler: Handler) -> web.StreamResponse:
            visitor = self._by_handler.get(request.protocol)
            if visitor is None:  # of another listener
                return await handler(request)
            self._waiting.discard(visitor.peer, visitor)
            self._answered.add(visitor.peer, visitor)
            try:
                return await handler(request)
            finally:
                if visitor in self._visitors:
                    self._answered.discard(visitor.peer, visitor)
                    self._waiting.add(visitor.peer, visitor)

        return middleware

    def streams(self, request: web.Request) -> None:
        """The connection of ``request`` has become a WebSocket, which has times of its own."""
        visitor = self._by_handler.get(request.protocol)
        if visitor is not None:
            self._answered.discard(visitor.peer, visitor)

    def open(
        self,
        listeners: list[socket.socket],
        server: web.Server,
        tls: ssl.SSLContext | None,
        on_fault: Callable[[BaseException], None],
    ) -> None:
        """Accept from ``listeners``, which listen already; ``on_fault`` is told if that ends by itself."""

        def take(accepted: socket.socket) -> None:
            self._take(accepted, server, tls)

        self._listeners = listeners
        accepting = [accept_all(each, take, log, relieve=self._relieve) for each in listeners]
        self._tasks = [watched(work, on_fault) for work in (*accepting, self._sweep())]

    async def close(self) -> None:
        """Accept no more, and end those that wait."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for listener in self._listeners:
            listener.close()
        while (visitor := self._waiting.first_to_go()) is not None:
            self._end(visitor)

    def _take(self, accepted: socket.socket, server: web.Server, tls: ssl.SSLContext | None) -> None:
        accepted.setblocking(False)
        try:
            peer = str(accepted.getpeername()[0])
        except (OSError, IndexError):  # gone already
            accepted.close()
            return
        visitor = Visitor(accepted, peer)
        self._visitors[visitor] = None
        self._waiting.add(visitor.peer, visitor)
        if len(self._waiting) > self._max_waiting or len(self._visitors) > self._max_connections:
            self._relieve()
        if visitor in self._visitors:
            visitor.arriving = watched(self._arrive(visitor, accepted, server, tls), self._failed)

    async def _arrive(
        self, visitor: Visitor, accepted: socket.socket, server: web.Server, tls: ssl.SSLContext | None
    ) -> None:
        """Shake hands, if there is TLS, and let aiohttp serve."""
        loop = asyncio.get_running_loop()

        def handler() -> _Handler:
            made = _Handler(
                server,
                loop=loop,
                access_log=None,
                keepalive_timeout=HEADER_S,
                lingering_time=1.0,
                on_lost=lambda: self._gone(visitor),
                on_nonsense=lambda error: self._nonsense(visitor, error),
            )
            visitor.handler = made
            self._by_handler[made] = visitor
            return made

        try:
            await loop.connect_accepted_socket(
                handler, accepted, ssl=tls, ssl_handshake_timeout=HEADER_S if tls else None
            )
        except (OSError, ssl.SSLError):  # no TLS, or gone
            self._told.write(logging.INFO, visitor.peer, "%s: did not shake hands", visitor.peer)
            self._gone(visitor)
        except asyncio.CancelledError:
            self._gone(visitor)
            raise
        finally:
            if visitor not in self._visitors:
                accepted.close()

    def _relieve(self) -> None:
        """End the connection that is missed least: one that has not asked for anything yet."""
        visitor = self._waiting.first_to_go()
        if visitor is None:
            self._told.write(logging.WARNING, "full", "all %d connections are in use", len(self._visitors))
            return
        self._told.write(
            logging.WARNING, visitor.peer, "%s: too many connections that ask for nothing; ended one", visitor.peer
        )
        self._end(visitor)

    def _end(self, visitor: Visitor) -> None:
        visitor.cut()
        self._gone(visitor)

    def _gone(self, visitor: Visitor) -> None:
        self._visitors.pop(visitor, None)
        self._waiting.discard(visitor.peer, visitor)
        self._answered.discard(visitor.peer, visitor)
        self._by_handler.pop(visitor.handler, None)
        visitor.handler = visitor.arriving = None

    async def _sweep(self) -> None:
        while True:
            await asyncio.sleep(SWEEP_S)
            for queue, most_s, what in (
                (self._waiting, HEADER_S, "asked for nothing"),
                (self._answered, ANSWER_S, "did not take its answer"),
            ):
                for visitor in queue.longer_than(most_s):
                    self._told.write(logging.INFO, visitor.peer, "%s: %s for %g s; ended", visitor.peer, what, most_s)
                    self._end(visitor)

    def _nonsense(self, visitor: Visitor, error: BaseException) -> None:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        self._told.write(logging.INFO, visitor.peer, "%s: sent no request (%.80s)", visitor.peer, reason)

    def _failed(self, error: BaseException) -> None:
        self._told.write(logging.ERROR, "failed", "a connection could not be served: %s", error, error=error)


def max_connections(max_clients: int) -> int:
    """How many connections may be open: as many as clients and connections that wait, where descriptors allow it.

    The soft limit on descriptors is raised as far as the hard one where that is needed.
    """
    wanted = max_clients + 2 * MAX_WAITING
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        needed = wanted + RESERVED_DESCRIPTORS
        if soft != resource.RLIM_INFINITY and soft < needed:
            soft = needed if hard == resource.RLIM_INFINITY else min(hard, needed)
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
            return max(soft - RESERVED_DESCRIPTORS, 1)
    return wanted


RESERVED_DESCRIPTORS = 192
"""For what else is open: the bundle, logs, and connections between being accepted and being ended."""
