"""A server over a scene in memory, on a real socket, and a client that does as it is told."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from aiohttp.test_utils import TestServer

from cags_common.geometry import Pose
from cags_common.transport.base import ConnectionEndedError
from cags_common.transport.websocket import ClientWebSocket, connect
from cags_protocol import SUBPROTOCOL, ClientSession
from cags_protocol import events as ev
from cags_protocol.wire.limits import MAX_MESSAGE_BYTES
from cags_protocol.wire.messages import Control, PoseSample
from cags_server.http.app import App
from cags_server.scene.collection import Collection
from cags_server.scene.library import SceneLibrary
from cags_server.settings import ServeSettings
from support.server_scene import FRAMES, hello, library


def now_us() -> int:
    return time.monotonic_ns() // 1000


@asynccontextmanager
async def serving(scene: SceneLibrary | None = None, **settings: Any) -> AsyncIterator[tuple[App, TestServer]]:
    chosen = ServeSettings(bundle="in memory", reference_width=64, reference_height=48, **settings)
    app = App(Collection.of(scene or library()), chosen)
    server = TestServer(app.web_app())
    await server.start_server()
    try:
        yield app, server
    finally:
        await app.drain()
        await server.close()
        app.close()


def stream_url(server: TestServer) -> str:
    return f"ws://{server.host}:{server.port}/stream"


class Client:
    """A client that shakes hands and then does as it is told."""

    def __init__(self, transport: ClientWebSocket, **changes: Any) -> None:
        self.transport, self.events = transport, list[Any]()
        self.session = ClientSession(now_us=now_us())
        self.session.hello(hello(**changes), now_us=now_us())

    @classmethod
    async def join(cls, server: TestServer, **changes: Any) -> Client:
        token = changes.pop("header_token", "")
        transport = await connect(
            stream_url(server), subprotocol=SUBPROTOCOL, max_message_bytes=MAX_MESSAGE_BYTES, token=token
        )
        return cls(transport, **changes)

    async def until(self, kind: type, count: int = 1) -> list[Any]:
        """Exchange messages until ``count`` events of ``kind`` have come."""
        async with asyncio.timeout(20):
            while len(found := [e for e in self.events if isinstance(e, kind)]) < count:
                await self.exchange()
        return found

    async def exchange(self) -> None:
        """Say what is to be said, and take one message, or send a pose where none comes."""
        self.session.handle_timer(now_us=now_us())
        try:
            for data in self.session.data_to_send(now_us()):
                await self.transport.send(data)
            async with asyncio.timeout(0.02):
                self.session.receive(await self.transport.recv(), now_us=now_us())
        except TimeoutError:
            self.session.send_poses([PoseSample(now_us(), Pose.identity())], now_us=now_us())
        except ConnectionEndedError as error:
            self.session.connection_lost(str(error), now_us=now_us())
        while (event := self.session.next_event()) is not None:
            self.events.append(event)

    async def leave(self) -> None:
        """Say goodbye, and close the connection."""
        self.session.bye("done", now_us=now_us())
        for data in self.session.data_to_send(now_us()):
            await self.transport.send(data)
        await self.transport.close()

    async def play(self) -> None:
        """Watch the clip to its end."""
        await self.until(ev.FrameEnded)
        begun = len(self.events)
        self.session.control(Control("play", 0, now_us() + 300_000), now_us=now_us())
        async with asyncio.timeout(20):
            while not any(isinstance(e, ev.FrameEnded) and e.message.frame == FRAMES - 1 for e in self.events[begun:]):
                await self.exchange()
