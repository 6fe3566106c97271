"""The server's shell: HTTP and WebSocket on one port, one :class:`~cags_server.connection.Connection` a client."""

from __future__ import annotations

import asyncio
import errno
import itertools
import logging
import os
import signal
from collections.abc import Callable
from pathlib import Path

from aiohttp import web

from cags_common.errors import NetworkError, OutputError
from cags_common.transport.websocket import ServerWebSocket
from cags_protocol import SUBPROTOCOL, ServerSessionSettings, SessionTimers
from cags_protocol.limits import MAX_CLIENT_MESSAGE_BYTES
from cags_protocol.messages import Hello, RefusalCode
from cags_server.admission import (
    HANDSHAKES_BEYOND_CLIENTS,
    header_allowed,
    origin_allowed,
    tls_context,
    token_allowed,
)
from cags_server.client_task import ClientTask, now_us
from cags_server.connection import Connection
from cags_server.event_file import EventFile
from cags_server.library import SceneLibrary
from cags_server.metrics import Totals, exposition
from cags_server.quota import Quotas
from cags_server.records import StreamStats
from cags_server.render_pool import RenderPool
from cags_server.render_slots import RenderSlots
from cags_server.session_log import write_session
from cags_server.settings import ServeSettings

log = logging.getLogger(__name__)


class App:
    """One served scene and its clients."""

    def __init__(self, library: SceneLibrary, settings: ServeSettings) -> None:
        self._library, self._settings = library, settings
        self._render_slots = RenderSlots(settings.workers)
        self._names = itertools.count(1)
        self._clients: dict[str, tuple[ClientTask, Connection]] = {}
        self._executor = RenderPool(settings.workers, self._served)
        self._executor.submit(library.warm)
        self._ended = Totals()
        self._draining = False
        self._empty = asyncio.Event()
        self._empty.set()

    def web_app(self) -> web.Application:
        """Routes: health, readiness, metrics, the bundle's public manifest, and the stream."""
        app = web.Application()
        app.router.add_get("/healthz", self._health)
        app.router.add_get("/readyz", self._ready)
        app.router.add_get("/metrics", self._metrics)
        app.router.add_get("/bundle", self._bundle)
        app.router.add_get("/stream", self._stream)
        return app

    def sessions(self) -> list[tuple[str, StreamStats]]:
        """Name and figures of every client that has been let in."""
        return [(name, c.stats) for name, (_, c) in list(self._clients.items()) if c.streamer is not None]

    def _served(self) -> int:
        """How many have been let in: not those who have yet to say hello."""
        return sum(connection.streamer is not None for _, connection in self._clients.values())

    async def drain(self) -> None:
        """Let no one in any more, and say goodbye to everybody who is."""
        self._draining = True
        for task, _ in list(self._clients.values()):
            task.say_goodbye("the server is shutting down")
        try:
            async with asyncio.timeout(self._settings.drain_s):
                await self._empty.wait()
        except TimeoutError:
            log.warning("%d clients did not leave within %g s", len(self._clients), self._settings.drain_s)

    def close(self) -> None:
        """Stop rendering."""
        self._executor.shutdown(wait=True, cancel_futures=True)

    async def _health(self, request: web.Request) -> web.Response:
        return web.json_response({"status": "ok", "clients": len(self._clients)})

    async def _ready(self, request: web.Request) -> web.Response:
        status = 503 if self._draining else 200
        return web.json_response({"status": "draining" if self._draining else "ready"}, status=status)

    async def _metrics(self, request: web.Request) -> web.Response:
        page = exposition(self._ended, (stats for _, stats in self.sessions()))
        return web.Response(text=page, headers={"Content-Type": "text/plain; version=0.0.4; charset=utf-8"})

    async def _bundle(self, request: web.Request) -> web.Response:
        if not header_allowed(self._settings.token, request.headers.get("Authorization")):
            return web.json_response({"error": "the token is missing or wrong"}, status=401)
        return web.Response(body=self._library.manifest.public_json(), content_type="application/json")

    async def _stream(self, request: web.Request) -> web.StreamResponse:
        refusal = self._refusal(request)
        if refusal is not None:
            return refusal
        transport = await ServerWebSocket.accept(
            request, subprotocol=SUBPROTOCOL, max_message_bytes=MAX_CLIENT_MESSAGE_BYTES
        )
        name = f"s{next(self._names)}"
        events = EventFile(Path(self._settings.event_traces), name) if self._settings.event_traces else None
        connection = self._connection(name, request.headers.get("Authorization"), events)
        task = ClientTask(transport, connection, self._executor, slow_s=self._settings.slow_s)
        self._clients[name] = task, connection
        self._empty.clear()
        log.info("%s: joined from %s", name, transport.peer)
        try:
            await task.run()
        finally:
            self._leave(name, connection)
            if events is not None:
                events.close()
        return transport.response

    def _refusal(self, request: web.Request) -> web.Response | None:
        """Why a request is turned away before any WebSocket: draining, a strange origin, a flood of handshakes."""
        if self._draining:
            return web.json_response({"error": "the server is shutting down"}, status=503)
        origin = request.headers.get("Origin")
        if not origin_allowed(origin, request.headers.get("Host"), self._settings.origins):
            return web.json_response({"error": f"origin {origin} is not allowed; list it with --origins"}, status=403)
        if len(self._clients) >= self._settings.max_clients + HANDSHAKES_BEYOND_CLIENTS:
            return web.json_response({"error": "too many connections; try again later"}, status=503)
        return None

    def _connection(self, name: str, header: str | None, events: EventFile | None) -> Connection:
        settings = self._settings
        session = ServerSessionSettings(
            timers=SessionTimers(idle_us=round(settings.idle_s * 1e6)),
            max_queue_bytes=round(settings.max_queue_mb * 1e6),
        )

        def admit(hello: Hello) -> tuple[RefusalCode, str, str] | None:
            if not token_allowed(settings.token, hello, header):
                return RefusalCode.TOKEN, "token", "the token is missing or wrong; give the server's with --token"
            if self._served() >= settings.max_clients:
                return RefusalCode.FULL, "", f"{settings.max_clients} clients are here already; try again later"
            return None

        return Connection(
            self._library,
            settings,
            name=name,
            now_us=now_us(),
            session_settings=session,
            admit=admit,
            fetches=True,
            render_slots=self._render_slots,
            trace=None if events is None else events.trace,
            quotas=Quotas(messages=settings.max_message_rate, poses=settings.max_pose_rate),
        )

    def _leave(self, name: str, connection: Connection) -> None:
        del self._clients[name]
        connection.release()
        if not self._clients:
            self._empty.set()
        if connection.streamer is not None:
            self._ended.add(connection.stats)
        ending = connection.ending
        log.info("%s: left (%s)", name, f"{ending.code}: {ending.reason}" if ending else "lost")
        if self._settings.session_logs:
            try:
                write_session(Path(self._settings.session_logs), name, connection.stats, ending)
            except OutputError as error:  # a full disk is no reason to stop serving
                log.warning("%s", error)


async def serve(library: SceneLibrary, settings: ServeSettings, on_ready: Callable[[str, int, App], None]) -> None:
    """Serve until SIGTERM or SIGINT. ``on_ready`` is told the host, the actual port and what serves there.

    Raises :class:`NetworkError` where the address cannot be listened on.
    """
    tls = tls_context(settings.tls_cert, settings.tls_key)
    app = App(library, settings)
    runner = web.AppRunner(app.web_app(), access_log=None, shutdown_timeout=settings.drain_s)
    await runner.setup()
    try:
        site = web.TCPSite(runner, settings.host, settings.port, ssl_context=tls)
        try:
            await site.start()
        except OSError as error:
            raise NetworkError(
                f"cannot listen on {settings.host}:{settings.port} ({_reason(error)}); {_way_out(error)}"
            ) from error
        stop = _stop_on_signals()
        on_ready(settings.host, int(runner.addresses[0][1]), app)
        await stop.wait()
        await app.drain()
    finally:
        await runner.cleanup()
        app.close()


def _reason(error: OSError) -> str:
    return os.strerror(error.errno).lower() if error.errno and error.errno > 0 else str(error)


def _way_out(error: OSError) -> str:
    if error.errno in (errno.EADDRINUSE, errno.EACCES):
        return "stop the program that uses it or give another --port"
    return "give --host an address of this machine, such as 127.0.0.1 or 0.0.0.0"


def _stop_on_signals() -> asyncio.Event:
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    return stop
