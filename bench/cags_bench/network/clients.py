"""Headless clients of one real server: does the data of each frame arrive before the frame is displayed?

The server is a separate process and renders references for every client. The clients share another process. They use
the real protocol over real sockets, send head poses and acknowledge everything, but neither decode nor draw. Each frame
must be complete (its base layers and its ``frame_end``) when it is displayed. References depend on the processor of the
renderer, so late ones are counted separately. The client simulates its link: data from the socket counts, and is
acknowledged, when the link would have delivered it.
"""

from __future__ import annotations

import asyncio
import tempfile
import time
import urllib.request
from contextlib import suppress
from pathlib import Path
from typing import Any

from cags_bench.demo.processes import ProcessGroup
from cags_bench.sim.session import Scenario
from cags_common.bundle import Manifest
from cags_common.geometry import Intrinsics
from cags_common.poses import Focus, PoseTrace, open_poses
from cags_common.transport import websocket
from cags_common.transport.base import ConnectionEndedError, Transport
from cags_protocol import PROTOCOL_VERSION, ClientSession
from cags_protocol import events as ev
from cags_protocol.wire.limits import MAX_MESSAGE_BYTES, SUBPROTOCOL
from cags_protocol.wire.messages import Control, Hello, PoseSample
from cags_shaper.link import WEBSOCKET_OVERHEAD_BYTES, Link, LinkSettings, tcp_wire_bytes

CLIENT_FPS = 5.0
START_DELAY_US = 1_000_000
"""Time from the arrival of the first frame to its display."""

POSE_INTERVAL_US = 28_000
TIMEOUT_S = 60.0

DELAY_US = 10_000
"""One-way delay of a client's link."""


def now_us() -> int:
    """The clients' clock."""
    return time.monotonic_ns() // 1000


class HeadlessClient:
    """A viewer of the whole clip at :data:`CLIENT_FPS` that only records arrivals."""

    def __init__(self, transport: Transport, intrinsics: Intrinsics, poses: str, mbps: float | None = None) -> None:
        """``mbps``: rate of the client's link; None: unlimited."""
        self.ends: dict[int, int] = {}  # media frame -> arrival of its end
        self.references: dict[int, int] = {}
        self.started_us: int | None = None
        self.info: Manifest | None = None
        self._transport, self._intrinsics, self._poses_spec = transport, intrinsics, poses
        self._session = ClientSession(now_us=now_us())
        capped = LinkSettings(delay_us=DELAY_US, cap_bps=mbps * 1e6) if mbps else LinkSettings()
        self._link = Link[bytes](None, capped)
        self._walk: PoseTrace | None = None
        self._wake = asyncio.Event()

    async def watch(self) -> None:
        """Run from ``hello`` to the display of the last frame."""
        pose = open_poses(self._poses_spec, Focus((0.0, 0.0, 0.0), 1.0)).pose_at(0)
        hello = Hello(PROTOCOL_VERSION, self._intrinsics, pose, agent="cags-bench")
        self._session.hello(hello, now_us=now_us())
        reader, poser = asyncio.create_task(self._read()), asyncio.create_task(self._send_poses())
        try:
            async with asyncio.timeout(TIMEOUT_S):
                while not self._over():
                    await self._turn()
            self._session.bye(now_us=now_us())
            await self._send()
        finally:
            for task in (reader, poser):
                task.cancel()
            await asyncio.gather(reader, poser, return_exceptions=True)
            await self._transport.close()

    def due_us(self, frame: int) -> int:
        """Display time of ``frame``."""
        assert self.started_us is not None
        return self.started_us + round(frame * 1e6 / CLIENT_FPS)

    def _over(self) -> bool:
        if self._session.closed:
            return True
        return self.started_us is not None and self.info is not None and now_us() > self.due_us(self.info.frames)

    async def _turn(self) -> None:
        self._wake.clear()
        self._receive()
        self._session.handle_timer(now_us=now_us())
        await self._send()
        times = (self._session.next_timer_us(), self._link.next_delivery_us())
        due_us = min((time for time in times if time is not None), default=None)
        wait_s = 0.1 if due_us is None else min(max((due_us - now_us()) / 1e6, 0.0), 0.1)
        with suppress(TimeoutError):
            await asyncio.wait_for(self._wake.wait(), wait_s)

    def _receive(self) -> None:
        """Receive what the link has delivered."""
        at_us = now_us()
        for data in self._link.pop_due(at_us):
            self._session.receive(data, now_us=at_us)
            while (event := self._session.next_event()) is not None:
                self._on_event(event, at_us)

    async def _send(self) -> None:
        for data in self._session.data_to_send(now_us()):
            await self._transport.send(data)

    async def _read(self) -> None:
        try:
            while True:
                data = bytes(await self._transport.recv())
                self._link.push(now_us(), data, tcp_wire_bytes(len(data) + WEBSOCKET_OVERHEAD_BYTES))
                self._wake.set()
        except ConnectionEndedError as error:
            self._session.connection_lost(str(error), now_us=now_us())
            self._wake.set()

    def _on_event(self, event: ev.ClientEvent, at_us: int) -> None:
        match event:
            case ev.Welcomed(welcome, _):
                self.info = Manifest.from_json(welcome.info)
                self._walk = open_poses(
                    self._poses_spec, Focus(self.info.focus_centre, self.info.focus_radius, self.info.up)
                )
            case ev.FrameEnded(message, _):
                self.ends.setdefault(message.frame, at_us)
                if self.started_us is None and self.info is not None:
                    self.started_us = at_us + START_DELAY_US
                    rate = CLIENT_FPS / self.info.fps
                    self._session.control(Control("play", 0, self.started_us, rate), now_us=at_us)
            case ev.ReferenceReceived(reference, _):
                self.references.setdefault(reference.frame, at_us)
            case _:
                pass

    async def _send_poses(self) -> None:
        while True:
            if self._walk is not None and not self._session.closed:
                at_us = now_us()
                since_us = 0 if self.started_us is None else max(at_us - self.started_us + START_DELAY_US, 0)
                self._session.send_poses([PoseSample(at_us, self._walk.pose_at(since_us))], now_us=at_us)
                self._wake.set()
            await asyncio.sleep(POSE_INTERVAL_US / 1e6)


def clients_line(base: Scenario, count: int, mbps: float | None = None) -> dict[str, Any]:
    """Play ``count`` clients at one server, and count frames and references that were late."""
    with tempfile.TemporaryDirectory(prefix="cags-network-") as folder, ProcessGroup(Path(folder)) as group:
        started = group.start(
            "cags_server",
            ["--bundle", str(base.bundle), "--port", "0", "--max-clients", str(count), "--json"],
        ).ready()
        address = f"127.0.0.1:{started['port']}"
        began_s, spent_s = time.monotonic(), _processor_s(address)
        clients = asyncio.run(watch_all(f"ws://{address}/stream", base.client.intrinsics, count, mbps))
        spent_s, took_s = _processor_s(address) - spent_s, time.monotonic() - began_s
    frames = min((client.info.frames for client in clients if client.info is not None), default=0)
    margins = [margins_us(client, client.ends, frames) for client in clients]
    pictures = [margins_us(client, client.references, frames) for client in clients]
    known = sorted(m for each in margins for m in each if m is not None)
    of_each = [frames - missed([each]) for each in pictures]
    return {
        "case": "clients",
        "clients": count,
        "fps": CLIENT_FPS,
        "mbps": mbps,
        "frames": count * frames,
        "deadlines_missed": missed(margins) if frames else None,
        "margin_ms_p1": known[len(known) // 100] / 1e3 if known else None,
        "references_late_or_skipped": missed(pictures),
        "references_late": sum(margin is not None and margin < 0 for each in pictures for margin in each),
        "references_of_a_client": [min(of_each, default=0), max(of_each, default=0)],
        "server_cores": round(spent_s / took_s, 2),
    }


def _processor_s(address: str) -> float:
    """Processor time that the server has used so far."""
    with urllib.request.urlopen(f"http://{address}/metrics", timeout=TIMEOUT_S) as answer:
        lines = answer.read().decode().splitlines()
    return sum(float(line.split()[1]) for line in lines if line.startswith("process_cpu_seconds_total "))


async def watch_all(url: str, intrinsics: Intrinsics, count: int, mbps: float | None = None) -> list[HeadlessClient]:
    """``count`` clients watch the clip at the same time, each on its own walk."""
    clients = []
    for number in range(count):
        transport = await websocket.connect(url, subprotocol=SUBPROTOCOL, max_message_bytes=MAX_MESSAGE_BYTES)
        clients.append(HeadlessClient(transport, intrinsics, f"synthetic:walking:seed={number}", mbps))
    await asyncio.gather(*(client.watch() for client in clients))
    return clients


def margins_us(client: HeadlessClient, arrived: dict[int, int], frames: int) -> list[int | None]:
    """Time from each frame's arrival to its display; None for frames that never arrived."""
    if client.started_us is None:
        return [None] * frames
    return [client.due_us(f) - arrived[f] if f in arrived else None for f in range(frames)]


def missed(margins: list[list[int | None]]) -> int:
    """Number of frames that arrived after their display, or never."""
    return sum(margin is None or margin < 0 for each in margins for margin in each)
