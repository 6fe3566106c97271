"""A server that means ill: a real one's stream, with something wrong in it from some message on.

Messages that are altered have headers and checksums that hold, so that what reads them has to notice by itself.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import threading
import zlib
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import msgpack
import numpy as np
from aiohttp import ClientSession, WSMsgType, web

from cags_common.errors import NetworkError
from cags_common.transport import websocket
from cags_common.video.h264 import H264Encoder
from cags_protocol import SUBPROTOCOL
from cags_protocol.wire.encoding import decode, encode
from cags_protocol.wire.limits import MAX_MESSAGE_BYTES
from cags_protocol.wire.messages import Bye, FrameEnd, ReferenceFrame, TileLayers, Welcome

Send = Callable[[bytes], Awaitable[None]]
Trick = Callable[[AsyncIterator[bytes], Send], Awaitable[None]]
"""Takes what the real server says, and says something else."""

WITHOUT_END = 10**9


def altered(change: Callable[[Any, bytes], tuple[Any, bytes] | None]) -> Trick:
    """Messages as ``change`` makes them: of a message and its payload; None leaves it out."""

    async def trick(heard: AsyncIterator[bytes], send: Send) -> None:
        async for data in heard:
            message, payload = decode(data)
            changed = change(message, bytes(payload))
            if changed is not None:
                await send(encode(*changed))

    return trick


def _sealed(header: dict[str, Any]) -> bytes:
    """A header with a checksum that fits."""
    head = msgpack.packb({**header, "crc": 0xFFFFFFFF})[:-4]
    return bytes(head + zlib.crc32(head).to_bytes(4, "big"))


NO_MESSAGE = _sealed({"type": "frame_end", "frame": "the last"})


async def malformed(heard: AsyncIterator[bytes], send: Send) -> None:
    """After five messages: headers that mean nothing, with checksums that fit."""
    number = 0
    async for data in heard:
        number += 1
        await send(data if number <= 5 else NO_MESSAGE)


async def silent(heard: AsyncIterator[bytes], send: Send) -> None:
    """Welcomes and says nothing more."""
    async for data in heard:
        if isinstance(decode(data)[0], Welcome):
            await send(data)


async def mute(heard: AsyncIterator[bytes], send: Send) -> None:
    """Says nothing at all."""
    async for _ in heard:
        pass


async def endless_tiles(heard: AsyncIterator[bytes], send: Send) -> None:
    """The first tile again and again, as another tile of another frame each time, as fast as they are taken."""
    async for data in heard:
        await send(data)
        message, payload = decode(data)
        if isinstance(message, TileLayers):
            for number in range(WITHOUT_END):
                await send(encode(replace(message, frame=number % 20, tile=number % 60_000), bytes(payload)))


async def endless_ends(heard: AsyncIterator[bytes], send: Send) -> None:
    """Ends of frames without end."""
    async for data in heard:
        await send(data)
        if isinstance(decode(data)[0], FrameEnd):
            for number in range(WITHOUT_END):
                await send(encode(FrameEnd(number % 20)))


async def hang_up(heard: AsyncIterator[bytes], send: Send) -> None:
    """Welcomes, and says goodbye at once: to whoever comes back, too."""
    async for data in heard:
        await send(data)
        if isinstance(decode(data)[0], Welcome):
            await send(encode(Bye("go away")))
            return


def _capacity(message: Any, payload: bytes) -> tuple[Any, bytes]:
    if isinstance(message, Welcome):
        return replace(message, info=lie_of_capacity(message.info)), b""
    return message, payload


def lie_of_capacity(info: bytes) -> bytes:
    """A manifest whose groups of frames are said to hold 3,900,000 splats each, of the highest degree: below the
    client's limit on splats, and beyond the memory that it gives on any machine.
    """
    table = json.loads(info)
    table["sh_degree"] = 3
    table["capacity"] = [3_900_000] * len(table["capacity"])
    return json.dumps(table).encode()


def _noise(message: Any, payload: bytes) -> tuple[Any, bytes]:
    """Tiles whose payloads are noise, with checksums that fit."""
    if not isinstance(message, TileLayers):
        return message, payload
    rng = np.random.default_rng(len(payload))
    parts = [rng.bytes(size) for size in message.sizes]
    return replace(message, crcs=tuple(zlib.crc32(part) for part in parts)), b"".join(parts)


def _picture_of(width: int, height: int) -> Callable[[Any, bytes], tuple[Any, bytes]]:
    picture = np.linspace(0, 1, width * height * 3, dtype=np.float32).reshape(height, width, 3)
    unit = H264Encoder(width, height, 30).encode(picture)

    def change(message: Any, payload: bytes) -> tuple[Any, bytes]:
        if isinstance(message, ReferenceFrame) and payload:
            return replace(message, idr=True), unit
        return message, payload

    return change


def _far_mark(message: Any, payload: bytes) -> tuple[Any, bytes]:
    """References that assume what never comes."""
    if isinstance(message, ReferenceFrame):
        return replace(message, basis=message.basis + 2**30), payload
    return message, payload


TRICKS: dict[str, Trick] = {
    "malformed": malformed,
    "silent": silent,
    "mute": mute,
    "endless-tiles": endless_tiles,
    "endless-ends": endless_ends,
    "hang-up": hang_up,
    "capacity": altered(_capacity),
    "noise": altered(_noise),
    "small-reference": altered(_picture_of(16, 16)),
    "large-reference": altered(_picture_of(3840, 2160)),
    "far-mark": altered(_far_mark),
}

BUNDLES: dict[str, Callable[[bytes], bytes | None]] = {
    "capacity": lie_of_capacity,
    "deep-manifest": lambda data: b"[" * 100_000,
    "no-manifest": lambda data: None,
}
"""What is answered instead of the manifest; None: a byte a second."""


class HostileServer:
    """Speaks for the server at ``port`` of this machine, in a thread of its own."""

    def __init__(self, port: int, trick: str) -> None:
        self._behind, self._trick = port, trick
        self._ready, self._stop = threading.Event(), asyncio.Event()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self.port, self.sessions = 0, 0
        self._thread.start()
        assert self._ready.wait(10)

    def close(self) -> None:
        """End, whoever is there."""
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(10)
        self._loop.close()

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._loop.run_until_complete(self._serve())

    async def _serve(self) -> None:
        app = web.Application()
        app.router.add_get("/bundle", self._bundle)
        app.router.add_get("/stream", self._stream)
        runner = web.AppRunner(app, access_log=None, shutdown_timeout=0.1)
        await runner.setup()
        await web.TCPSite(runner, "127.0.0.1", 0).start()
        self.port = runner.addresses[0][1]
        self._ready.set()
        await self._stop.wait()
        await runner.cleanup()
        for task in asyncio.all_tasks() - {asyncio.current_task()}:
            task.cancel()
        await asyncio.sleep(0.05)

    async def _bundle(self, request: web.Request) -> web.StreamResponse:
        async with ClientSession() as session, session.get(f"http://127.0.0.1:{self._behind}/bundle") as answer:
            data = await answer.read()
        told = BUNDLES.get(self._trick, lambda same: same)(data)
        if told is not None:
            return web.Response(body=told)
        response = web.StreamResponse(headers={"Content-Length": str(len(data))})
        await response.prepare(request)
        with contextlib.suppress(ConnectionError):
            for byte in data:
                await response.write(bytes([byte]))
                await asyncio.sleep(1.0)
        return response

    async def _stream(self, request: web.Request) -> web.StreamResponse:
        self.sessions += 1
        response = web.WebSocketResponse(protocols=[SUBPROTOCOL], max_msg_size=0, autoping=True)
        await response.prepare(request)
        behind = await websocket.connect(
            f"ws://127.0.0.1:{self._behind}/stream", subprotocol=SUBPROTOCOL, max_message_bytes=MAX_MESSAGE_BYTES
        )

        async def heard() -> AsyncIterator[bytes]:
            while True:
                yield await behind.recv()

        async def pass_up() -> None:
            async for message in response:
                if message.type is WSMsgType.BINARY:
                    await behind.send(message.data)

        trick = TRICKS.get(self._trick, altered(lambda message, payload: (message, payload)))
        tasks = [asyncio.ensure_future(trick(heard(), response.send_bytes)), asyncio.ensure_future(pass_up())]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            for ended in await asyncio.gather(*tasks, return_exceptions=True):
                if isinstance(ended, Exception) and not isinstance(ended, NetworkError | ConnectionError):
                    raise ended
            behind.abort()
        return response


ALL = sorted(set(itertools.chain(TRICKS, BUNDLES)))


@contextmanager
def hostile_server(port: int, trick: str) -> Iterator[HostileServer]:
    """One that plays ``trick`` on whoever comes, with the stream of the server at ``port``."""
    made = HostileServer(port, trick)
    try:
        yield made
    finally:
        made.close()
