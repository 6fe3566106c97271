"""The page server: takes displayed frames from the client, gives them to pages, and takes poses and wishes back.

The client's display path only leaves the newest frame in a mailbox (:meth:`LiveView.show`). A pump in the event loop
picks it up, has one worker thread code it for every page that keeps up, and sends. So a slow page costs pictures on
that page and never time in the client.

There is one camera and one play. The page that has been open longest steers them; the others watch, and are told so.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import hmac
import json
import logging
import os
from collections.abc import Coroutine, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from typing import Any

from aiohttp import WSMsgType, web

from cags_client.output.page.assets import add_assets
from cags_client.output.page.controls import Controls, SceneInfo, ShownFrame
from cags_client.output.page.guard import guard, on_this_machine, same_origin
from cags_client.output.page.messages import (
    MAX_TEXT_BYTES,
    NAMED,
    OVERLAYS,
    PageHello,
    PageLook,
    PageMessage,
    PagePose,
    PageSet,
    PageShown,
    PageWindow,
    parse,
)
from cags_client.output.page.open_page import Page, kind_of
from cags_client.output.page.pictures import NEED_TRUTH, PICTURES, Gallery
from cags_client.output.page.poses import LivePoses
from cags_client.output.page.settings import ViewSettings
from cags_client.output.page.shaper_control import ShaperControl
from cags_client.playback.viewpoint import PoseSource
from cags_client.settings import RESOLUTIONS
from cags_common.errors import CagsError, ConfigError, NetworkError, ProtocolError
from cags_common.raster.base import Exactness
from cags_common.runtime.tasks import watched
from cags_common.transport.hosts import host_port, named
from cags_common.transport.websocket import CLOSE_TIMEOUT_S

EXACTNESSES = tuple(exactness.value for exactness in Exactness)

LOG = logging.getLogger(__name__)

MAX_PAGES, MAX_LINKS = 8, 32
"""Pages that have said hello, and WebSockets in all: one more ends the oldest that has not said it."""

HELLO_S = 5.0
"""How long a WebSocket stays open without a hello, from when the clip is known."""

TOO_MANY = f"{MAX_PAGES} pages are open already; close one"
REACHED_AT = {"localhost": "127.0.0.1", "0.0.0.0": "127.0.0.1", "::": "::1"}  # noqa: S104 - only compared
"""Where a browser on this machine finds a page that is served on more than one address."""

WRONG_TOKEN = 4401
"""The WebSocket's close code for a page without the right token."""

NO_ROOM = 4429
"""That of a page beyond :data:`MAX_PAGES`: browsers do not tell a page what HTTP answers to a WebSocket."""

MAX_REASON_BYTES = 123
"""Of a close frame (RFC 6455, section 5.5)."""

STATE_PERIOD_S = 0.25
SLOW_PAGE_S = 5.0
"""How long a page may take nothing: meanwhile the others get no pictures."""


class LiveView:
    """A frame sink (:meth:`show`) and a pose source (:attr:`poses`) around a small web server."""

    def __init__(self, settings: ViewSettings, walk: PoseSource) -> None:
        """``walk`` moves the camera until somebody takes hold of it. Raises :class:`ConfigError`."""
        self.settings = settings
        self.poses = LivePoses(walk)
        self.url = ""
        self._scene: SceneInfo | None = None
        self._controls: Controls | None = None
        self._attached = asyncio.Event()
        self._pages: dict[web.WebSocketResponse, Page] = {}
        self._links: dict[web.WebSocketResponse, asyncio.WriteTransport | None] = {}
        """All WebSockets, oldest first, those without a hello too."""
        self._newest: ShownFrame | None = None
        self._wake = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="cags-view")
        self._shaper = ShaperControl(settings.shaper_control) if settings.shaper_control else None
        self._link: dict[str, Any] | None = None
        """The newest answer of the shaper."""
        self._tasks: list[asyncio.Task[None]] = []
        self._runner: web.AppRunner | None = None

    # --------------------------------------------------------------------------------------------------- client's side

    async def start(self) -> str:
        """Serve the page; returns its address. Raises :class:`NetworkError` where the port is taken."""
        self._loop = asyncio.get_running_loop()
        app = web.Application(middlewares=[guard(named(self.settings.view_allow_host))])
        app.router.add_get("/live", self._live)
        add_assets(app)
        self._runner = web.AppRunner(app, access_log=None, shutdown_timeout=1.0)
        await self._runner.setup()
        host, port = self.settings.view_host, self.settings.view_port
        try:
            await web.TCPSite(self._runner, host, port).start()
        except OSError as error:
            await self._runner.cleanup()
            reason = error.strerror or str(error)
            if error.errno is not None and error.errno > 0:  # that of a name that is not found is negative
                reason = os.strerror(error.errno).lower()  # asyncio's own words repeat the address
            if error.errno in (errno.EADDRINUSE, errno.EACCES):
                way_out = "give another --view-port, or 0 for a free one"
            else:
                way_out = "give --view-host an address of this machine, such as 127.0.0.1"
            raise NetworkError(f"view_port {port} on {host} cannot be used ({reason}); {way_out}") from error
        port = self._runner.addresses[0][1]
        self.url = f"http://{host_port(REACHED_AT.get(host, host), port)}/"
        self._tasks = [watched(part(), self._failed) for part in (self._pump, self._tell)]
        return self.url

    def attach(self, scene: SceneInfo, controls: Controls) -> None:
        """The clip is known: pages may be told what they look at."""
        self._scene, self._controls = scene, controls
        self._attached.set()

    def show(self, shown: ShownFrame) -> None:
        """Take a displayed frame. Thread-safe; keeps only the newest, never waits."""
        self._newest = shown
        if self._loop is not None and not self._loop.is_closed():
            with contextlib.suppress(RuntimeError):  # the loop may close between the two lines
                self._loop.call_soon_threadsafe(self._wake.set)

    @property
    def pages(self) -> int:
        """How many pages are open."""
        return len(self._pages)

    async def stop(self) -> None:
        """Close all pages and the server."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for socket in list(self._pages):
            with contextlib.suppress(ConnectionError):
                await socket.close(code=1001, message=b"the client has ended")
        if self._runner is not None:
            await self._runner.cleanup()
        if self._shaper is not None:
            await self._shaper.close()
        self._worker.shutdown(wait=True)

    # ----------------------------------------------------------------------------------------------------------- HTTP

    async def _live(self, request: web.Request) -> web.WebSocketResponse:
        if not same_origin(request):
            raise web.HTTPForbidden(text="this WebSocket serves its own page only\n")
        if not self._made_room():
            raise web.HTTPServiceUnavailable(text=f"{MAX_LINKS} pages wait for the clip already; close one\n")
        socket = web.WebSocketResponse(
            timeout=CLOSE_TIMEOUT_S, max_msg_size=MAX_TEXT_BYTES, heartbeat=20.0, compress=False
        )
        self._links[socket] = request.transport if isinstance(request.transport, asyncio.WriteTransport) else None
        try:
            await socket.prepare(request)
            await self._attached.wait()
            await self._serve(socket)
        finally:
            self._forget(socket)
            self._links.pop(socket, None)
        return socket

    def _made_room(self) -> bool:
        """Whether there is room for another WebSocket; the oldest without a hello gives way where they are many."""
        if len(self._links) < MAX_LINKS:
            return True
        stranger = next((socket for socket in self._links if socket not in self._pages), None)
        if stranger is None or not self._attached.is_set():  # until then nobody is heard, so all are strangers
            return False
        self._hang_up(stranger)
        return True

    def _hang_up(self, socket: web.WebSocketResponse) -> None:
        """End a WebSocket at once, whether or not it takes anything."""
        if (transport := self._links.pop(socket, None)) is not None:
            transport.abort()

    async def _serve(self, socket: web.WebSocketResponse) -> None:
        try:
            async with asyncio.timeout(HELLO_S) as limit:
                async for message in socket:
                    if message.type is not WSMsgType.TEXT:
                        break
                    await self._take(socket, message.data)
                    if socket in self._pages:
                        limit.reschedule(None)
        except TimeoutError:
            await socket.close(code=1008, message=f"no hello within {HELLO_S:g} s".encode())

    async def _take(self, socket: web.WebSocketResponse, text: str) -> None:
        try:
            await self._on_message(socket, parse(text))
        except ProtocolError as error:
            whole = str(error).encode(errors="replace")[:MAX_REASON_BYTES].decode(errors="ignore")  # no cut character
            await socket.close(code=1008, message=whole.encode())
        except CagsError as error:
            await socket.send_str(json.dumps({"type": "error", "text": str(error)}))

    # -------------------------------------------------------------------------------------------------- page's wishes

    async def _on_message(self, socket: web.WebSocketResponse, message: PageMessage) -> None:
        if isinstance(message, PageHello):
            await self._welcome(socket, message)
            return
        page = self._pages.get(socket)
        if page is None:
            raise ProtocolError("page message before hello")
        match message:
            case PagePose(at_us, pose):
                if self._steers(socket):
                    self.poses.hold(pose, at_us)
            case PageShown(number, key):
                page.shown(number, key)
                self._wake.set()
            case PageWindow():
                page.window = message
                if self._steers(socket):
                    self._fit(page)
            case PageLook():
                page.look = message
                self._wake.set()
            case PageSet():
                if not self._steers(socket):
                    raise ConfigError("another page steers this client; this one watches")
                await self._set(message)
                await self._tell_state()

    def _steers(self, socket: web.WebSocketResponse) -> bool:
        """Whether the camera and the play are this page's: of all that are open, it came first."""
        return next(iter(self._pages), None) is socket

    def _forget(self, socket: web.WebSocketResponse) -> None:
        """The page is gone. Where it steered, the next one does, with a clock of its own."""
        steered = self._steers(socket)
        self._pages.pop(socket, None)
        if steered:
            self.poses.forget_times()
            if (following := next(iter(self._pages.values()), None)) is not None:
                self._fit(following)

    def _fit(self, page: Page) -> None:
        """Have pictures drawn for the window of the page that steers."""
        if page.window is not None and self._controls is not None:
            self._controls.set_window(page.window.width, page.window.height)

    async def _welcome(self, socket: web.WebSocketResponse, hello: PageHello) -> None:
        assert self._scene is not None
        assert self._controls is not None
        if not hmac.compare_digest(hello.token.encode(), self.settings.view_token.encode()):
            await socket.close(code=WRONG_TOKEN, message=b"wrong token" if hello.token else b"token needed")
            return
        if len(self._pages) >= MAX_PAGES and socket not in self._pages:
            await socket.close(code=NO_ROOM, message=TOO_MANY.encode())
            return
        peer = socket.get_extra_info("peername", ("",))
        kind = kind_of(hello, self.settings, local=on_this_machine(peer[0]))
        self._pages[socket] = Page(kind, self.settings, self._scene)
        await socket.send_str(json.dumps(scene_text(self._scene, self._controls, shaper=self._shaper is not None)))
        await socket.send_str(json.dumps(self._state(socket)))
        self._wake.set()

    async def _set(self, wish: PageSet) -> None:
        controls, value = self._controls, wish.value
        assert controls is not None
        assert self._scene is not None
        match wish.name:
            case "playing":
                controls.play() if value else controls.pause()
            case "frame":
                controls.seek(int(max(0, min(float(value or 0), self._scene.frames - 1))))
            case "rate":
                controls.set_rate(min(max(float(value or 0), 0.1), 4.0))
            case "loop":
                controls.set_loop(bool(value))
            case "held":
                if not value:
                    self.poses.release()
            case "restorer":
                controls.set_restorer(_one_of(wish, controls.restorers))
            case "exactness":
                controls.set_exactness(_one_of(wish, EXACTNESSES))
            case "resolution":
                controls.set_resolution(_one_of(wish, RESOLUTIONS))
            case _:
                if self._shaper is None:
                    raise ConfigError(f"{wish.name} needs a shaper: start the client with --shaper-control HOST:PORT")
                self._link = await self._shaper.ask(**{wish.name: None if value is None else float(value)})

    def _state(self, socket: web.WebSocketResponse) -> dict[str, Any]:
        assert self._controls is not None
        return state_text(self._controls, held=self.poses.held, steers=self._steers(socket), shaper=self._link)

    # ---------------------------------------------------------------------------------------------------------- frames

    async def _pump(self) -> None:
        """Send the newest frame to every page that keeps up; a frame that nobody could take waits for one that can."""
        loop = asyncio.get_running_loop()
        done: ShownFrame | None = None
        looked: dict[web.WebSocketResponse, tuple[ShownFrame, PageLook]] = {}
        while True:
            await self._wake.wait()
            self._wake.clear()
            shown, controls = self._newest, self._controls
            if shown is None or controls is None:
                continue
            if shown is not done:
                gallery = Gallery(shown, controls.truth if controls.has_truth else None)
                done = shown
            for socket, page in list(self._pages.items()):
                if looked.get(socket) == (shown, page.look) or not page.ready:
                    continue
                looked[socket] = (shown, page.look)
                try:
                    message = await loop.run_in_executor(self._worker, self._compose, page, gallery, controls)
                except Exception as error:  # whatever it was, the next frame may be fine: the page is told, the log too
                    LOG.exception("frame %d could not be put together for a page", shown.frame)
                    await self._broadcast({"type": "error", "text": f"frame {shown.frame}: {error}"})
                    continue
                began_s = loop.time()
                await self._sent(socket, socket.send_bytes(message))
                page.wrote(loop.time() - began_s)
            looked = {socket: value for socket, value in looked.items() if socket in self._pages}

    def _compose(self, page: Page, gallery: Gallery, controls: Controls) -> bytes:
        detail = controls.detail() if page.needs_detail() else None
        steers = next(iter(self._pages.values()), None) is page  # the time is of that page's clock
        return page.compose(gallery, detail, self.poses.time_of(gallery.shown.camera.pose) if steers else None)

    async def _tell(self) -> None:
        """Keep the pages told of the state, and of the shaper where there is one."""
        while True:
            await asyncio.sleep(STATE_PERIOD_S)
            if not self._pages or self._controls is None:
                continue
            if self._shaper is not None:
                try:
                    self._link = await self._shaper.ask()
                except NetworkError as error:
                    self._link = {"error": str(error)}
            await self._tell_state()

    async def _tell_state(self) -> None:
        for socket in list(self._pages):
            await self._sent(socket, socket.send_str(json.dumps(self._state(socket))))

    async def _broadcast(self, message: dict[str, Any]) -> None:
        text = json.dumps(message)
        for socket in list(self._pages):
            await self._sent(socket, socket.send_str(text))

    async def _sent(self, socket: web.WebSocketResponse, sending: Coroutine[Any, Any, None]) -> None:
        """Send to one page; one that takes nothing for a while is let go, as the others wait for it."""
        try:
            async with asyncio.timeout(SLOW_PAGE_S):
                await sending
        except TimeoutError:
            LOG.warning("a page took nothing for %g s and was let go", SLOW_PAGE_S)
            self._forget(socket)
            self._hang_up(socket)
        except (ConnectionError, RuntimeError):  # RuntimeError: it is closing
            self._forget(socket)

    def _failed(self, error: BaseException) -> None:
        LOG.error("the page's server has stopped: %s", error, exc_info=error)


def scene_text(scene: SceneInfo, controls: Controls, *, shaper: bool) -> dict[str, Any]:
    """What a page is told first: the scene, and what may be looked at and chosen here."""
    return {
        "type": "scene",
        **asdict(scene),
        "pictures": [name for name in PICTURES if controls.has_truth or name not in NEED_TRUTH],
        "overlays": [name for name in OVERLAYS if controls.has_truth or name != "score"],
        "settings": dict(zip(NAMED, (list(controls.restorers), [*EXACTNESSES], [*RESOLUTIONS]), strict=True)),
        "shaper": shaper,
    }


def state_text(controls: Controls, *, held: bool, steers: bool, shaper: dict[str, Any] | None) -> dict[str, Any]:
    """How things stand; ``steers``: whether they are the page's to change; ``shaper``: its answer, if there is one."""
    return {
        "type": "state",
        "playing": controls.playing,
        "loop": controls.loop,
        "rate": controls.rate,
        "held": held,
        "steers": steers,
        "away": controls.away,
        "settings": {name: getattr(controls, name) for name in NAMED},
        "shaper": shaper,
    }


def _one_of(wish: PageSet, choices: Sequence[str]) -> str:
    """The name that the page wishes. Raises :class:`ConfigError` for one that there is not."""
    if wish.value not in choices:
        raise ConfigError(f"{wish.name} = {wish.value!r} must be one of {', '.join(choices)}")
    return str(wish.value)
