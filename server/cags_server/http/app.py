"""The server's shell: HTTP and WebSocket on a port, a :class:`~cags_server.session.connection.Connection` a client."""

from __future__ import annotations

import asyncio
import errno
import gc
import itertools
import logging
import os
from collections.abc import Callable
from pathlib import Path

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

from cags_common.errors import CagsError, NetworkError, OutputError
from cags_common.runtime.endings import on_first_request
from cags_common.runtime.rare_log import RareLog
from cags_common.transport.accepting import listen_on
from cags_common.transport.base import ConnectionEndedError
from cags_common.transport.hosts import named
from cags_common.transport.websocket import ServerWebSocket
from cags_common.words import counted
from cags_protocol import SUBPROTOCOL, ServerSessionSettings, SessionTimers
from cags_protocol.wire.limits import MAX_CLIENT_MESSAGE_BYTES
from cags_protocol.wire.messages import Hello, RefusalCode
from cags_server.http.acceptor import BACKLOG, Acceptor, max_connections
from cags_server.http.admission import (
    MAX_HANDSHAKES,
    header_allowed,
    host_refusal,
    operator_allowed,
    origin_allowed,
    tls_context,
    token_allowed,
)
from cags_server.http.admission_rate import AdmissionRate
from cags_server.http.capacity import Capacity, capacity
from cags_server.http.client_task import ClientTask, now_us
from cags_server.http.event_file import EventFile
from cags_server.http.gallery.scenes import add_scenes
from cags_server.http.gallery.uploads import Uploads
from cags_server.http.memory import FreedMemory
from cags_server.http.page import add_page
from cags_server.http.status import SessionBook, page, why_ended
from cags_server.http.waiting_list import WaitingList
from cags_server.records import StreamStats, Totals, run_name, write_session
from cags_server.reference.render_pool import RenderPool
from cags_server.reference.render_slots import RenderSlots
from cags_server.scene.collection import Collection, UnknownSceneError
from cags_server.scene.library import SceneLibrary
from cags_server.session.connection import Connection
from cags_server.session.quota import Quotas
from cags_server.settings import ServeSettings

log = logging.getLogger(__name__)

MOST_BY_MEASURE = 256
"""Descriptors are kept for so many clients where their number is measured."""

GONE_BEFORE = 499
"""Status of a request whose client has closed the connection, as in nginx."""

DEFAULT_FPS = 30.0
"""Of a server that has no scene yet."""

MAX_AGENT = 60
"""Characters of a client's name for itself that are logged; it is printable, as every text on the wire."""

LINES_AT_ONCE = 16
"""Log lines about comings and goings of one address that may come at once; then there is one a second."""


class App:
    """Served scenes and their clients."""

    def __init__(self, scenes: Collection, settings: ServeSettings, acceptor: Acceptor | None = None) -> None:
        """``acceptor``: where its connections come from, if there is one that wants to know what they are at."""
        self._scenes, self._settings, self._acceptor = scenes, settings, acceptor
        self._told, self._turned_away = RareLog(log, burst=LINES_AT_ONCE), RareLog(log)
        self._turns = AdmissionRate()
        self._unvouched = WaitingList[str]()  # names of those who have shown neither a Hello nor the token yet
        self._render_slots = RenderSlots(settings.workers)
        self._run, self._names = run_name(), itertools.count(1)
        self._clients: dict[str, tuple[ClientTask, Connection]] = {}
        self._executor = RenderPool(settings.workers, self._served)
        self._uploads = Uploads(scenes, settings, self._streams) if settings.accept_uploads else None
        self._ended = Totals()
        self._memory = FreedMemory(lambda: self._clients, scenes.forget_decoded)
        self._book = SessionBook()
        self._draining, self._unwritten = False, 0  # session logs that are being written
        if not scenes.several:
            self._executor.submit(scenes.library(None).warm)
            self._executor.submit(self._read_ahead, scenes.library(None), 0)
        self._empty = asyncio.Event()
        self._empty.set()

    def web_app(self) -> web.Application:
        """Routes: the viewer, the scenes, health, readiness, metrics, the operator's page, and the stream."""
        app = web.Application(
            middlewares=([] if self._acceptor is None else [self._acceptor.middleware()]) + [self._guard()]
        )
        add_page(app, gallery=self._scenes.several)
        upload_bytes = round(self._settings.upload_mb * 1e6) if self._uploads else 0
        if self._uploads:
            self._uploads.add_routes(app)
        add_scenes(app, self._scenes, self._settings.token, upload_bytes=upload_bytes)
        app.router.add_get("/healthz", self._health)
        app.router.add_get("/readyz", self._ready)
        app.router.add_get("/metrics", self._metrics)
        app.router.add_get("/status", self._status)
        app.router.add_get("/status.json", self._status)
        app.router.add_get("/stream", self._stream)
        return app

    def _guard(self) -> Middleware:
        @web.middleware
        async def guard(request: web.Request, handler: Handler) -> web.StreamResponse:
            refusal = host_refusal(self._settings, request.headers.get("Host"))
            return await handler(request) if refusal is None else web.json_response({"error": refusal}, status=403)

        return guard

    def sessions(self) -> list[tuple[str, StreamStats]]:
        """Name and figures of every client that has been let in."""
        return [(name, c.stats) for name, (_, c) in list(self._clients.items()) if c.streamer is not None]

    def _read_ahead(self, library: SceneLibrary, frame: int) -> None:
        """While nobody watches yet, get on with what the first viewer will need, frame by frame."""
        if not (self._clients or self._draining) and library.read_ahead(frame):
            self._executor.submit(self._read_ahead, library, frame + 1)

    def _served(self) -> int:
        """How many have been let in: not those who have yet to say hello."""
        return sum(connection.streamer is not None for _, connection in self._clients.values())

    def _full(self) -> str | None:
        """Why nobody more is let in; None while there is room."""
        most = self._settings.max_clients
        if most:
            return f"{most} clients are here already; try again later" if self._served() >= most else None
        now = self._capacity()
        return now.reason() if self._served() >= now.clients else None

    def _capacity(self) -> Capacity:
        costs = [(stats.careful, stats.light) for _, stats in self.sessions()]
        costs.append((self._ended.careful, self._ended.light))
        fps = max((manifest.fps for manifest in self._scenes.manifests), default=DEFAULT_FPS)
        return capacity(self._settings, fps, costs)

    def _streams(self, request: web.Request) -> None:
        """A request takes the time that it takes."""
        if self._acceptor is not None:
            self._acceptor.streams(request)

    async def drain(self) -> None:
        """Let no one in any more, and say goodbye to everybody who is."""
        self._draining = True
        if self._uploads:
            await self._uploads.close()
        for task, _ in list(self._clients.values()):
            task.say_goodbye("the server is shutting down")
        try:
            async with asyncio.timeout(self._settings.drain_s):
                await self._empty.wait()
        except TimeoutError:
            clients, logs = len(self._clients), self._unwritten
            text = "%d clients did not leave, and %d session logs were not written, within %g s"
            log.warning(text, clients, logs, self._settings.drain_s)

    def close(self) -> None:
        """Stop rendering."""
        self._memory.close()
        self._executor.shutdown(wait=True, cancel_futures=True)

    async def _health(self, request: web.Request) -> web.Response:
        return web.json_response({"status": "ok", "clients": len(self._clients)})

    async def _ready(self, request: web.Request) -> web.Response:
        status = 503 if self._draining else 200
        return web.json_response({"status": "draining" if self._draining else "ready"}, status=status)

    def _operator(self, request: web.Request) -> web.Response | None:
        """Why a request for what operators see is turned away; None where it is not."""
        if operator_allowed(self._settings.token, request.headers.get("Authorization"), request.remote or ""):
            return None
        reason = "give the token, as a bearer's or as the password of any name; without --token, ask from this machine"
        asks = {"WWW-Authenticate": 'Basic realm="cags-server", charset="UTF-8"'} if self._settings.token else {}
        return web.json_response({"error": reason}, status=401 if self._settings.token else 403, headers=asks)

    async def _status(self, request: web.Request) -> web.Response:
        refusal = self._operator(request)
        if refusal is not None:
            return refusal
        report = {
            "bundle": self._scenes.title,
            "max_clients": self._settings.max_clients or self._capacity().clients,
            "draining": self._draining,
            **self._book.report(self.sessions()),
        }
        if request.path.endswith(".json"):
            return web.json_response(report)
        security = {"Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; frame-ancestors 'none'"}
        text = page(report, self._scenes.title)
        return web.Response(text=text, content_type="text/html", charset="utf-8", headers=security)

    async def _metrics(self, request: web.Request) -> web.Response:
        if self._settings.token and (refusal := self._operator(request)) is not None:
            return refusal
        from cags_server.http.metrics import exposition  # with all of Prometheus' client: once somebody asks

        live, tasks = (stats for _, stats in self.sessions()), len(asyncio.all_tasks())
        page = exposition(self._ended, live, tasks=tasks, decoded_bytes=self._scenes.decoded_bytes)
        return web.Response(text=page, headers={"Content-Type": "text/plain; version=0.0.4; charset=utf-8"})

    async def _stream(self, request: web.Request) -> web.StreamResponse:
        refusal = self._refusal(request)
        if refusal is not None:
            return refusal
        try:
            library = await self._library(request.query.get("scene"))
        except UnknownSceneError as error:
            return web.json_response({"error": str(error)}, status=404)
        except CagsError as error:
            self._turned_away.write(logging.WARNING, "scene", "a scene cannot be opened: %s", error)
            return web.json_response({"error": "the server cannot read the scene at present"}, status=503)
        header = request.headers.get("Authorization")
        vouched = bool(self._settings.token) and header_allowed(self._settings.token, header)
        if not vouched and not await self._turns.take():
            return web.json_response({"error": "too many ask at once; try again later"}, status=503)
        try:
            transport = await ServerWebSocket.accept(
                request, subprotocol=SUBPROTOCOL, max_message_bytes=MAX_CLIENT_MESSAGE_BYTES
            )
        except ConnectionEndedError:
            return web.Response(status=GONE_BEFORE)
        self._streams(request)
        name = f"s{next(self._names)}"
        events = EventFile(Path(self._settings.event_traces), self._run, name) if self._settings.event_traces else None
        connection = self._connection(library, name, transport.peer, header, events)
        task = ClientTask(
            transport, connection, self._executor, slow_s=self._settings.slow_s, clients=lambda: len(self._clients)
        )
        self._clients[name] = task, connection
        self._empty.clear()
        if not vouched:
            self._wait_for_hello(transport.peer, name)
        try:
            await task.run()
        finally:
            if events is not None:
                events.close()
            if self._leave(name, transport.peer, connection) and self._settings.session_logs:
                await self._write_log(name, connection)
            self._empty_if_so()
        return transport.response

    async def _library(self, name: str | None) -> SceneLibrary:
        """The scene of that name; one that has yet to be opened is read while the loop serves others."""
        if self._scenes.is_open(name):
            return self._scenes.library(name)
        return await asyncio.to_thread(self._scenes.library, name)

    def _wait_for_hello(self, peer: str, name: str) -> None:
        """One that has shown nothing yet may take the place of one that has been at it for longer."""
        self._unvouched.add(peer, name)
        if len(self._unvouched) > MAX_HANDSHAKES and (longest := self._unvouched.first_to_go()) is not None:
            task, _ = self._clients[longest]
            self._unvouched.discard(task.peer, longest)
            task.cut("others wait, and you said nothing")

    def _refusal(self, request: web.Request) -> web.Response | None:
        """Why a request is turned away before any WebSocket: draining, or a strange origin."""
        if self._draining:
            return web.json_response({"error": "the server is shutting down"}, status=503)
        origin = request.headers.get("Origin")
        host, names = request.headers.get("Host"), named(self._settings.hosts)
        if not origin_allowed(origin, host, self._settings.origins, names):
            return web.json_response({"error": f"origin {origin} is not allowed; list it with --origins"}, status=403)
        return None

    def _connection(
        self, library: SceneLibrary, name: str, peer: str, header: str | None, events: EventFile | None
    ) -> Connection:
        settings = self._settings
        session = ServerSessionSettings(
            timers=SessionTimers(idle_us=round(settings.idle_s * 1e6)),
            max_queue_bytes=round(settings.max_queue_mb * 1e6),
        )

        def admit(hello: Hello) -> tuple[RefusalCode, str, str] | None:
            self._unvouched.discard(peer, name)
            if not token_allowed(settings.token, hello, header):
                return RefusalCode.TOKEN, "token", "the token is missing or wrong; give the server's with --token"
            if (reason := self._full()) is not None:
                return RefusalCode.FULL, "", reason
            self._book.began(name, peer)
            agent = f" ({hello.agent[:MAX_AGENT]})" if hello.agent else ""
            self._told.write(logging.INFO, peer, "%s: joined from %s%s", name, peer, agent)
            return None

        return Connection(
            library,
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

    def _leave(self, name: str, peer: str, connection: Connection) -> bool:
        """Forget a client, and tell how the session went; whether it had been let in."""
        del self._clients[name]
        self._unvouched.discard(peer, name)
        let_in = connection.streamer is not None
        connection.release(now_us())
        self._memory.session_ended()
        ending = connection.ending
        why, stats = why_ended(ending), connection.stats
        status = self._book.ended(name, stats, ending)
        if not let_in or status is None:
            self._turned_away.write(logging.INFO, peer, "%s: not let in, from %s (%s)", name, peer, why)
            return False
        self._ended.add(stats)
        due = status.in_time + status.late
        self._told.write(
            logging.INFO, peer, "%s: left (%s) after %.0f s, data of %d of %s in time, %s, short of %s",
            name, why, status.seconds, status.in_time, counted(due, "due frame"), counted(status.stalls, "stall"),
            status.short_of,
        )  # fmt: skip
        return True

    async def _write_log(self, name: str, connection: Connection) -> None:
        """Write what is remembered of an ended session, in a thread: thousands of records take a while."""
        folder, stats, ending = Path(self._settings.session_logs), connection.stats, connection.ending
        self._unwritten += 1
        try:
            await asyncio.to_thread(write_session, folder, self._run, name, stats, ending)
        except OutputError as error:  # a full disk is no reason to stop serving
            self._told.write(logging.WARNING, "session log", "%s", error)
        finally:
            self._unwritten -= 1

    def _empty_if_so(self) -> None:
        """Let a server that drains go on once everybody has left and is written down."""
        if not (self._clients or self._unwritten):
            self._empty.set()


async def serve(scenes: Collection, settings: ServeSettings, on_ready: Callable[[str, int, App], None]) -> None:
    """Serve until SIGTERM or SIGINT. ``on_ready`` is told the host, the actual port and what serves there.

    Raises :class:`NetworkError` where the address cannot be listened on.
    """
    tls = tls_context(settings.tls_cert, settings.tls_key)
    try:
        listeners = listen_on(settings.host, settings.port, BACKLOG)
    except OSError as error:
        raise NetworkError(
            f"cannot listen on {settings.host}:{settings.port} ({_reason(error)}); {_way_out(error)}"
        ) from error
    acceptor = Acceptor(max_connections(settings.max_clients or MOST_BY_MEASURE))
    app = App(scenes, settings, acceptor)
    runner = web.AppRunner(app.web_app(), access_log=None, shutdown_timeout=settings.drain_s)
    await runner.setup()
    assert runner.server is not None
    failed: list[BaseException] = []
    stop = _stop_on_signals()

    def fault(error: BaseException) -> None:
        failed.append(error)
        stop.set()

    try:
        gc.freeze()  # modules and the scene live as long as the server: collections need not look at them
        acceptor.open(listeners, runner.server, tls, fault)
        on_ready(settings.host, int(listeners[0].getsockname()[1]), app)
        await stop.wait()
        await app.drain()
    finally:
        await acceptor.close()
        await runner.cleanup()
        app.close()
    if failed:
        raise NetworkError(f"no connections can be accepted any more ({failed[0]}); start the server again")


def _reason(error: OSError) -> str:
    return os.strerror(error.errno).lower() if error.errno and error.errno > 0 else error.strerror or str(error)


def _way_out(error: OSError) -> str:
    if error.errno in (errno.EADDRINUSE, errno.EACCES):
        return "stop the program that uses it or give another --port"
    return "give --host an address of this machine, such as 127.0.0.1 or 0.0.0.0"


def _stop_on_signals() -> asyncio.Event:
    stop = asyncio.Event()
    on_first_request(lambda _: stop.set())
    return stop
