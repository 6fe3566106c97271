"""Clients that mean ill: ``python -m support.attackers PORT NAME[:ARGUMENT[:TOKEN]] ..`` runs until it is killed."""

from __future__ import annotations

import asyncio
import contextlib
import os
import resource
import socket
import struct
import sys
import time
from collections.abc import Callable
from typing import Any

from cags_common.errors import NetworkError
from cags_common.geometry import Intrinsics, Pose
from cags_common.tiles.inventory import InventoryEntry
from cags_common.transport import websocket
from cags_common.transport.base import ConnectionEndedError
from cags_protocol import PROTOCOL_VERSION, SUBPROTOCOL
from cags_protocol.wire.encoding import encode
from cags_protocol.wire.limits import MAX_MESSAGE_BYTES
from cags_protocol.wire.messages import Ack, Control, Hello, KeyframeRequest, PoseBatch, PoseSample, SeqRange

VIEW = Intrinsics.of_fov(320, 240, 1.2, 0.95)
HALF = b"GET /stream HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Half: "


def connected(port: int) -> socket.socket | None:
    """A raw connection, if it is to be had."""
    try:
        sock = socket.create_connection(("127.0.0.1", port), timeout=1.0)
    except OSError:
        return None
    sock.setblocking(False)
    return sock


def half_requests(port: int, count: str = "1100") -> None:
    """Keep ``count`` connections open that never finish their header, and open those anew that are ended."""
    _allow_descriptors(int(count) + 64)
    held: list[socket.socket] = []
    while True:
        alive = []
        for sock in held:
            try:
                sock.send(b"x")
                if sock.recv(1) == b"":
                    raise ConnectionResetError
            except BlockingIOError:
                alive.append(sock)
            except OSError:
                sock.close()
        held = alive
        for _ in range(min(int(count) - len(held), 200)):
            sock = connected(port)
            if sock is None:
                break
            with contextlib.suppress(OSError):
                sock.send(HALF)
            held.append(sock)
        time.sleep(0.05)


def connection_storm(port: int) -> None:
    """Connect and reset, as fast as it goes (up to about a thousand a second)."""
    linger = struct.pack("ii", 1, 0)
    while True:
        sock = connected(port)
        if sock is not None:
            with contextlib.suppress(OSError):
                sock.send(os.urandom(64))
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
            sock.close()
        time.sleep(0.001)


def garbage(port: int) -> None:
    """Requests that are none."""
    while True:
        sock = connected(port)
        if sock is not None:
            with contextlib.suppress(OSError):
                sock.send(b"GET / HTTP/1.1\r\nHost: x\r\nContent-Length: -7\r\nBad\x00Name: y\r\n\r\n")
                time.sleep(0.002)
            sock.close()
        time.sleep(0.002)


async def joined(port: int, *, hello: bool = True, token: str = "") -> Any:
    """A WebSocket, which says Hello or nothing."""
    transport = await websocket.connect(
        f"ws://127.0.0.1:{port}/stream", subprotocol=SUBPROTOCOL, max_message_bytes=MAX_MESSAGE_BYTES, token=token
    )
    if hello:
        pose = Pose.looking_at((0.0, 0.5, 3.0), (0.0, 0.0, 0.0))
        await transport.send(encode(Hello(PROTOCOL_VERSION, VIEW, pose, token=token)))
    return transport


async def silent_sockets(port: int, count: str = "100") -> None:
    """Keep ``count`` WebSockets open that never say Hello."""
    _allow_descriptors(int(count) + 64)

    async def one() -> None:
        while True:
            with contextlib.suppress(NetworkError, OSError):
                transport = await joined(port, hello=False)
                await transport.recv()
            await asyncio.sleep(0.1)

    await asyncio.gather(*(one() for _ in range(int(count))))


async def _swallow(transport: Any) -> None:
    while True:
        await transport.recv()


async def _flood(port: int, message: Callable[[int], bytes], rate: float, token: str = "") -> None:
    """Send ``message(n)`` at ``rate``, taking all that comes; join again when that ends."""
    while True:
        with contextlib.suppress(NetworkError, ConnectionEndedError, OSError):
            transport = await joined(port, token=token)
            swallowing = asyncio.create_task(_swallow(transport))
            try:
                began, number = time.monotonic(), 0
                while not swallowing.done():
                    while number < (time.monotonic() - began) * rate:
                        await transport.send(message(number))
                        number += 1
                    await asyncio.sleep(0.002)
            finally:
                swallowing.cancel()
                await asyncio.gather(swallowing, return_exceptions=True)
        await asyncio.sleep(0.2)


def _now_us() -> int:
    return time.monotonic_ns() // 1000


async def evictions(port: int, rate: str = "900", token: str = "") -> None:
    """Acknowledgements with as many evicted records as one may have, within the quota of messages."""
    records = tuple(InventoryEntry(2**30 + i, i, 1) for i in range(512))
    data = encode(Ack((SeqRange(0, 0),), 1, 0, 0, records))
    await _flood(port, lambda number: data, float(rate), token)


async def poses(port: int, rate: str = "900", token: str = "") -> None:
    """Poses at the edge of the quotas."""
    pose = Pose.identity()

    def message(number: int) -> bytes:
        return encode(PoseBatch((PoseSample(_now_us(), pose), PoseSample(_now_us() + 1, pose))))

    await _flood(port, message, float(rate), token)


async def seeks(port: int, rate: str = "900", token: str = "") -> None:
    """Jumps to and fro, each of which takes everything back and asks for a new picture."""

    def message(number: int) -> bytes:
        if number % 2:
            return encode(KeyframeRequest(number))
        return encode(Control("seek" if number % 4 else "play", number % 20, _now_us() + 100_000))

    await _flood(port, message, float(rate), token)


async def clock_jump(port: int, days: str = "11", token: str = "") -> None:
    """A paused viewer whose clock leaps."""
    leap_us = round(float(days) * 86_400e6)

    def message(number: int) -> bytes:
        if number == 1:
            return encode(Control("pause", 3, _now_us()))
        return encode(PoseBatch((PoseSample(_now_us() + (leap_us if number > 20 else 0), Pose.identity()),)))

    await _flood(port, message, 30.0, token)


async def stalled(port: int, count: str = "8", token: str = "") -> None:
    """Join, and take nothing any more."""

    async def one() -> None:
        while True:
            with contextlib.suppress(NetworkError, OSError):
                transport = await joined(port, token=token)
                await transport.recv()
                began = time.monotonic()
                while time.monotonic() - began < 30:
                    await transport.send(encode(PoseBatch((PoseSample(_now_us(), Pose.identity()),))))
                    await asyncio.sleep(0.05)
            await asyncio.sleep(0.2)

    await asyncio.gather(*(one() for _ in range(int(count))))


async def storm(port: int, rate: str = "40", token: str = "") -> None:
    """Join, take the first message, reset: again and again."""

    async def one() -> None:
        with contextlib.suppress(NetworkError, OSError):
            transport = await joined(port, token=token)
            with contextlib.suppress(ConnectionEndedError):
                await transport.recv()
            transport.abort()

    tasks = set()
    while True:
        task = asyncio.create_task(one())
        tasks.add(task)
        task.add_done_callback(tasks.discard)
        await asyncio.sleep(1 / float(rate))


def _allow_descriptors(count: int) -> None:
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(max(count, 1024), hard), hard))


ATTACKS: dict[str, Any] = {
    each.__name__.replace("_", "-"): each
    for each in (
        half_requests, connection_storm, garbage, silent_sockets, evictions, poses, seeks, clock_jump, stalled, storm,
    )
}  # fmt: skip


async def run(port: int, wanted: list[str]) -> None:
    """Several attacks beside each other, each as ``NAME``, ``NAME:ARGUMENT`` or ``NAME:ARGUMENT:TOKEN``."""
    print("ready", flush=True)
    running = []
    for each in wanted:
        name, *arguments = each.split(":")
        chosen = ATTACKS[name]
        work = (
            chosen(port, *arguments)
            if asyncio.iscoroutinefunction(chosen)
            else asyncio.to_thread(chosen, port, *arguments)
        )
        running.append(work)
    await asyncio.gather(*running)


if __name__ == "__main__":
    os.nice(10)  # attackers sit at machines of their own
    asyncio.run(run(int(sys.argv[1]), sys.argv[2:]))
