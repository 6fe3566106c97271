"""The page server: takes displayed frames from the client, gives them to pages, and takes poses and wishes back.

The client's display path only leaves the newest frame in a mailbox (:meth:`LiveView.show`). A pump in the event loop
picks it up, has one worker thread code it for every page that keeps up, and sends. So a slow page costs pictures on
that page and never time in the client.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
from collections.abc import Coroutine, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from importlib.resources import files
from typing import Any

from aiohttp import WSMsgType, web

from cags_client.output.page.controls import Controls, SceneInfo, ShownFrame
from cags_client.output.page.guard import guard, on_this_machine, same_origin
from cags_client.output.page.messages import (
    MAX_TEXT_BYTES,
    PageAction,
    PageHello,
    PageLook,
    PageMessage,
    PagePose,
    PageSetting,
    PageShown,
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

EXACTNESSES = tuple(exactness.value for exactness in Exactness)

LOG = logging.getLogger(__name__)

MAX_PAGES = 8
REACHED_AT = {"localhost": "127.0.0.1", "0.0.0.0": "127.0.0.1", "::": "::1"}  # noqa: S104 - only compared
"""Where a browser on this machine finds a page that is served on more than one address."""

STATE_PERIOD_S = 0.25
SLOW_PAGE_S = 5.0
"""How long a page may take nothing: meanwhile the others get no pictures."""

SCRIPTS = "js"
TYPES = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}


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
        self._links: dict[web.WebSocketResponse, asyncio.WriteTransport] = {}
        self._newest: ShownFrame | None = None
        self._wake = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="cags-view")
        self._shaper = ShaperControl(settings.shaper_control) if settings.shaper_control else None
        self._tasks: list[asyncio.Task[None]] = []
        self._runner: web.AppRunner | None = None

    # --------------------------------------------------------------------------------------------------- client's side

    async def start(self) -> str:
        """Serve the page; returns its address. Raises :class:`NetworkError` where the port is taken."""
        self._loop = asyncio.get_running_loop()
        app = web.Application(middlewares=[guard(named(self.settings.view_allow_host))])
        app.router.add_get("/live", self._live)
        app.router.add_get("/", self._asset)
        app.router.add_get("/{name}", self._asset)
        app.router.add_get("/" + SCRIPTS + "/{script}", self._asset)
        self._runner = web.AppRunner(app, access_log=None, shutdown_timeout=1.0)
        await self._runner.setup()
        host, port = self.settings.view_host, self.settings.view_port
        try:
            await web.TCPSite(self._runner, host, port).start()
        except OSError as error:
            await self._runner.cleanup()
            reason = error.strerror or str(error)
            raise NetworkError(
                f"view_port {port} on {host} cannot be used ({reason}); --view-port 0 picks one"
            ) from error
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

    async def _asset(self, request: web.Request) -> web.Response:
        script = request.match_info.get("script")
        name = script or request.match_info.get("name") or "index.html"
        root = files("cags_client.output.page") / "static" / (SCRIPTS if script else "")
        known = {entry.name for entry in root.iterdir() if entry.is_file()}
        if name not in known:
            raise web.HTTPNotFound(text=f"there is no {name} here\n")
        kind = TYPES.get(name.rpartition(".")[2], "application/octet-stream")
        return web.Response(body=(root / name).read_bytes(), content_type=kind, charset="utf-8")

    async def _live(self, request: web.Request) -> web.WebSocketResponse:
        if not same_origin(request):
            raise web.HTTPForbidden(text="this WebSocket serves its own page only\n")
        if len(self._pages) >= MAX_PAGES:
            raise web.HTTPServiceUnavailable(text=f"{MAX_PAGES} pages are open already; close one\n")
        socket = web.WebSocketResponse(max_msg_size=MAX_TEXT_BYTES, heartbeat=20.0, compress=False)
        await socket.prepare(request)
        if isinstance(request.transport, asyncio.WriteTransport):
            self._links[socket] = request.transport
        try:
            await self._attached.wait()
            await self._serve(socket)
        finally:
            self._pages.pop(socket, None)
            self._links.pop(socket, None)
        return socket

    async def _serve(self, socket: web.WebSocketResponse) -> None:
        async for message in socket:
            if message.type is not WSMsgType.TEXT:
                break
            try:
                await self._on_message(socket, parse(message.data))
            except ProtocolError as error:
                await socket.close(code=1008, message=str(error).encode()[:120])
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
            case PagePose(number, pose):
                self.poses.hold(pose, number)
            case PageShown(number, key):
                page.shown(number, key)
                self._wake.set()
            case PageLook():
                page.look = message
                self._wake.set()
            case PageAction():
                self._act(message)
                await self._broadcast(self._state())
            case PageSetting():
                await self._change(message)
                await self._broadcast(self._state())

    async def _welcome(self, socket: web.WebSocketResponse, hello: PageHello) -> None:
        assert self._scene is not None
        assert self._controls is not None
        peer = socket.get_extra_info("peername", ("",))
        kind = kind_of(hello, self.settings, local=on_this_machine(peer[0]))
        self._pages[socket] = Page(kind, self.settings, self._scene)
        pictures = [name for name in PICTURES if self._controls.has_truth or name not in NEED_TRUTH]
        scene = {
            "type": "scene",
            **asdict(self._scene),
            "pictures": pictures,
            "restorers": list(self._controls.restorers),
            "shaper": self._shaper is not None,
        }
        await socket.send_str(json.dumps(scene))
        await socket.send_str(json.dumps(self._state()))
        self._wake.set()

    def _act(self, wish: PageAction) -> None:
        controls = self._controls
        assert controls is not None
        assert self._scene is not None
        match wish.action:
            case "play":
                controls.play()
            case "pause":
                controls.pause()
            case "seek":
                controls.seek(max(0, min(int(wish.value), self._scene.frames - 1)))
            case "rate":
                controls.set_rate(min(max(wish.value, 0.1), 4.0))
            case "loop":
                controls.set_loop(bool(wish.value))
            case "release":
                self.poses.release()

    async def _change(self, wish: PageSetting) -> None:
        controls = self._controls
        assert controls is not None
        if wish.name == "restorer":
            controls.set_restorer(_one_of(wish, controls.restorers))
        elif wish.name == "exactness":
            controls.set_exactness(_one_of(wish, EXACTNESSES))
        elif wish.name == "resolution":
            controls.set_resolution(_one_of(wish, RESOLUTIONS))
        elif self._shaper is None:
            raise ConfigError(f"{wish.name} needs a shaper: start the client with --shaper-control HOST:PORT")
        else:
            value = None if wish.value is None else float(wish.value)
            await self._shaper.ask(**{wish.name: value})

    def _state(self) -> dict[str, Any]:
        controls = self._controls
        assert controls is not None
        return {
            "type": "state",
            "playing": controls.playing,
            "loop": controls.loop,
            "rate": controls.rate,
            "restorer": controls.restorer,
            "exactness": controls.exactness,
            "resolution": controls.resolution,
            "held": self.poses.held,
            "away": controls.away,
        }

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
        return page.compose(gallery, detail, self.poses.number_of(gallery.shown.camera.pose))

    async def _tell(self) -> None:
        """Keep the pages told of the state, and of the shaper where there is one."""
        while True:
            await asyncio.sleep(STATE_PERIOD_S)
            if not self._pages or self._controls is None:
                continue
            await self._broadcast(self._state())
            if self._shaper is not None:
                try:
                    answer = await self._shaper.ask()
                except NetworkError as error:
                    answer = {"error": str(error)}
                await self._broadcast({"type": "shaper", **answer})

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
            self._pages.pop(socket, None)
            transport = self._links.get(socket)
            if transport is not None:
                transport.abort()
        except (ConnectionError, RuntimeError):  # RuntimeError: it is closing
            self._pages.pop(socket, None)

    def _failed(self, error: BaseException) -> None:
        LOG.error("the page's server has stopped: %s", error, exc_info=error)


def _one_of(wish: PageSetting, choices: Sequence[str]) -> str:
    """The name that the page wishes. Raises :class:`ConfigError` for one that there is not."""
    if wish.value not in choices:
        raise ConfigError(f"{wish.name} = {wish.value!r} must be one of {', '.join(choices)}")
    return str(wish.value)
