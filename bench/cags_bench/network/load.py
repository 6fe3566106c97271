"""Sessions under load without content: real sessions and link state between peers that only count bytes.

At the frame rate, the server plans as many bytes as its link state allows: tiles with a deadline and one reference. The
client records their arrival. This measures sending alone, and a thousand sessions take less than a minute.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from cags_bench.sim.world import Direction, World
from cags_common.geometry import Intrinsics, Pose
from cags_protocol import PROTOCOL_VERSION, ClientSession, Outgoing, ServerSession
from cags_protocol import events as ev
from cags_protocol.wire.messages import Hello, PoseSample, ReferenceFrame, TileLayers, Welcome
from cags_server.link import LinkState
from cags_shaper.link import Link, LinkSettings
from cags_shaper.trace import Trace

INTRINSICS = Intrinsics.of_fov(800, 600, 1.0, 0.8)
FPS = 30.0
TILES_PER_FRAME = 10
TILE_DEADLINE_US = 200_000
REFERENCE_BYTES = 2_500
POSE_INTERVAL_US = 28_000
"""36 head poses per second, as from a headset."""

ZEROS = bytes(4_000_000)
"""Payload of all messages; only its length matters."""


@dataclass
class Arrivals:
    """What arrived over a session. ``latency_us`` is from the server's planning to the client's event."""

    tiles: list[tuple[int, int, int]] = field(default_factory=list)  # (arrived, latency, bytes)
    references: list[tuple[int, int]] = field(default_factory=list)  # (arrived, latency)
    estimates: list[tuple[int, float]] = field(default_factory=list)  # (time, bps)
    kernel: list[tuple[int, float]] = field(default_factory=list)  # (time, bps): TCP's own delivery rate, if available
    sent_bytes: int = 0
    dropped: int = 0
    wasted_bytes: int = 0
    """Bytes sent of messages that were dropped before their end."""


class LoadServer:
    """Plans at fixed times and sends through a session."""

    def __init__(
        self,
        link_state: LinkState,
        log: Arrivals,
        fps: float,
        kernel_bps: Callable[[], float | None] = lambda: None,
    ) -> None:
        """``kernel_bps`` returns the operating system's estimate of the path's rate; it is called at every plan."""
        self.session = ServerSession(now_us=0)
        self._kernel_bps = kernel_bps
        self._link_state, self._log, self._fps = link_state, log, fps
        self._frame = 0
        self._due_us: int | None = None

    def receive(self, data: bytes, now_us: int) -> None:
        """See :class:`~cags_bench.sim.world.Peer`."""
        self.session.receive(data, now_us=now_us)
        self._settle(now_us)

    def data_to_send(self, now_us: int) -> list[bytes]:
        """See :class:`~cags_bench.sim.world.Peer`."""
        out = self.session.data_to_send(now_us)
        self._log.sent_bytes += sum(map(len, out))
        self._settle(now_us)
        return out

    def next_timer_us(self) -> int | None:
        """See :class:`~cags_bench.sim.world.Peer`."""
        times = [t for t in (self.session.next_timer_us(), self._due_us) if t is not None]
        return min(times) if times else None

    def handle_timer(self, now_us: int) -> None:
        """See :class:`~cags_bench.sim.world.Peer`."""
        self.session.handle_timer(now_us=now_us)
        if self._due_us is not None and now_us >= self._due_us:
            self._plan(now_us)
            self._due_us += round(1e6 / self._fps)
        self._settle(now_us)

    def _plan(self, now_us: int) -> None:
        self._log.estimates.append((now_us, self._link_state.estimate_bps(now_us)))
        kernel_bps = self._kernel_bps()
        if kernel_bps is not None:
            self._log.kernel.append((now_us, kernel_bps))
        allowed_bps = self._link_state.allowance_bps(now_us)
        self._frame += 1
        budget = int(allowed_bps / self._fps / 8) - REFERENCE_BYTES - self.session.queued_bytes
        self._queue(ReferenceFrame(now_us, self._frame, Pose.identity(), INTRINSICS), REFERENCE_BYTES, 0, now_us)
        size = min(budget // TILES_PER_FRAME, len(ZEROS))
        if size > 0:
            for tile in range(TILES_PER_FRAME):
                self._queue(TileLayers(now_us, tile, 0, 1, (size,), (0,)), size, 1, now_us)

    def _queue(self, message: TileLayers | ReferenceFrame, size: int, priority: int, now_us: int) -> None:
        payload = memoryview(ZEROS)[:size]
        self.session.queue(Outgoing(message, payload, priority, now_us + TILE_DEADLINE_US), now_us=now_us)

    def _settle(self, now_us: int) -> None:
        while (event := self.session.next_event()) is not None:
            match event:
                case ev.Joined():
                    self.session.accept(Welcome("load", self._fps, 2**31 - 1), now_us=now_us)
                    self._due_us = now_us
                case ev.Acknowledged(sample):
                    self._link_state.on_ack(sample)
                    self.session.rate_hint_bps = self._link_state.allowance_bps(now_us)
                case ev.Dropped(_, _, sent_bytes):
                    self._log.dropped += 1
                    self._log.wasted_bytes += sent_bytes


class LoadClient:
    """Joins, sends poses and records arrivals. Frame numbers are the times at which the server planned."""

    def __init__(self, log: Arrivals) -> None:
        self.session = ClientSession(now_us=0)
        self.session.hello(Hello(PROTOCOL_VERSION, INTRINSICS, Pose.identity()), now_us=0)
        self._log = log
        self._pose_us = POSE_INTERVAL_US

    def receive(self, data: bytes, now_us: int) -> None:
        """See :class:`~cags_bench.sim.world.Peer`."""
        self.session.receive(data, now_us=now_us)
        while (event := self.session.next_event()) is not None:
            match event:
                case ev.TileReceived(message, payload):
                    self._log.tiles.append((now_us, now_us - message.frame, len(payload)))
                case ev.ReferenceReceived(reference, _):
                    self._log.references.append((now_us, now_us - reference.frame))

    def data_to_send(self, now_us: int) -> list[bytes]:
        """See :class:`~cags_bench.sim.world.Peer`."""
        return self.session.data_to_send(now_us)

    def next_timer_us(self) -> int | None:
        """See :class:`~cags_bench.sim.world.Peer`."""
        timer_us = self.session.next_timer_us()
        return self._pose_us if timer_us is None else min(timer_us, self._pose_us)

    def handle_timer(self, now_us: int) -> None:
        """See :class:`~cags_bench.sim.world.Peer`."""
        self.session.handle_timer(now_us=now_us)
        if now_us >= self._pose_us:
            self.session.send_poses([PoseSample(now_us, Pose.identity())], now_us=now_us)
            self._pose_us = now_us + POSE_INTERVAL_US


def load_world(trace: Trace, link_state: LinkState, settings: LinkSettings, fps: float = FPS) -> tuple[World, Arrivals]:
    """A session over ``trace`` (the reverse direction is unlimited), and the record of its arrivals."""
    log = Arrivals()
    server, client = LoadServer(link_state, log, fps), LoadClient(log)
    down = Direction(Link(trace, settings), client.receive)
    up = Direction(Link(None, LinkSettings(delay_us=settings.delay_us)), server.receive)
    return World(server, client, down, up, lambda _: False), log


def run_load(trace: Trace, link_state: LinkState, duration_us: int, settings: LinkSettings) -> Arrivals:
    """Run one session for ``duration_us``."""
    world, log = load_world(trace, link_state, settings)
    advance(world, duration_us)
    return log


def advance(world: World, until_us: int) -> None:
    """Run a world until ``until_us``."""
    world.run(lambda: world.now_us >= until_us, until_us + 60_000_000)
