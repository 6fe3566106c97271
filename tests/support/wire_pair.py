"""A client and a server session that meet in memory, over a network whose faults the test chooses."""

from __future__ import annotations

import heapq
import itertools
import random
from collections.abc import Callable
from typing import Any

from cags_common.geometry import Intrinsics, Pose
from cags_protocol import ClientSession, Outgoing, ServerSession
from cags_protocol import events as ev
from cags_protocol.wire.limits import PROTOCOL_VERSION
from cags_protocol.wire.messages import Hello, ReferenceFrame, TileLayers, Welcome

INTRINSICS = Intrinsics.of_fov(400, 300, 1.0, 0.8)

Deliveries = list[tuple[int, bytes]]
"""What becomes of one message: when each copy of it arrives (microseconds from now), and its bytes."""

Fate = Callable[[bytes], Deliveries]


def steady(delay_us: int) -> Fate:
    """Every message arrives once, whole, after ``delay_us``."""
    return lambda data: [(delay_us, data)]


def hello(**changes: Any) -> Hello:
    """A valid Hello."""
    return Hello(**{"version": PROTOCOL_VERSION, "intrinsics": INTRINSICS, "pose": Pose.identity(), **changes})


def tile(frame: int, number: int, size: int, **how: Any) -> Outgoing:
    """A tile of one LoD of ``size`` bytes."""
    payload = random.Random(f"{frame} {number}").randbytes(size)
    return Outgoing(TileLayers(frame, number, 0, 1, (size,), (0,)), payload, **how)


def reference(frame: int, seq: int, size: int, **how: Any) -> Outgoing:
    """A reference picture of ``size`` bytes."""
    return Outgoing(ReferenceFrame(frame, seq, Pose.identity(), INTRINSICS), b"r" * size, **how)


class Pair:
    """Two sessions and the network between them. ``server_log`` and ``client_log`` hold (time, event)."""

    def __init__(self, down: Fate | None = None, up: Fate | None = None, **settings: Any) -> None:
        self.now_us = 0
        self.server = ServerSession(settings.get("server"), now_us=0)
        self.client = ClientSession(settings.get("client"), now_us=0)
        self.server_log: list[tuple[int, Any]] = []
        self.client_log: list[tuple[int, Any]] = []
        self.down, self.up = down or steady(10_000), up or steady(10_000)
        self.packets_down: list[bytes] = []
        self._flying: list[tuple[int, int, Any, bytes]] = []
        self._count = itertools.count()

    def open(self, welcome: Welcome | None = None, **changes: Any) -> Pair:
        """Shake hands."""
        self.client.hello(hello(**changes), now_us=self.now_us)
        self.run(200_000)
        self.server.accept(welcome or Welcome("s", 30.0, 60, info=b"{}"), now_us=self.now_us)
        self.run(200_000)
        return self

    def queue(self, *outgoing: Outgoing) -> None:
        """Queue on the server, now."""
        for one in outgoing:
            self.server.queue(one, now_us=self.now_us)

    def run(self, duration_us: int, *, timers: bool = True) -> Pair:
        """Let time pass."""
        end_us = self.now_us + duration_us
        while True:
            self._exchange()
            upcoming = [self._flying[0][0]] if self._flying else []
            if timers:
                upcoming += [t for s in (self.server, self.client) if (t := s.next_timer_us()) is not None]
            upcoming = [max(t, self.now_us) for t in upcoming]
            if not upcoming or min(upcoming) > end_us:
                break
            self.now_us = min(upcoming)
            self._arrive()
            for session in (self.server, self.client):
                due_us = session.next_timer_us()
                if timers and due_us is not None and due_us <= self.now_us:
                    session.handle_timer(now_us=self.now_us)
        self.now_us = end_us
        return self

    def server_events(self, kind: type[Any]) -> list[Any]:
        """The server's events of one kind."""
        return [event for _, event in self.server_log if isinstance(event, kind)]

    def client_events(self, kind: type[Any]) -> list[Any]:
        """The client's events of one kind."""
        return [event for _, event in self.client_log if isinstance(event, kind)]

    def tiles(self) -> list[tuple[int, int]]:
        """(frame, tile) in order of arrival."""
        return [(e.message.frame, e.message.tile) for e in self.client_events(ev.TileReceived)]

    def _exchange(self) -> None:
        for data in self.server.data_to_send(self.now_us):
            self.packets_down.append(data)
            self._fly(self.client, self.down(data))
        for data in self.client.data_to_send(self.now_us):
            self._fly(self.server, self.up(data))
        self._drain()

    def _fly(self, to: Any, deliveries: Deliveries) -> None:
        for delay_us, data in deliveries:
            heapq.heappush(self._flying, (self.now_us + delay_us, next(self._count), to, data))

    def _arrive(self) -> None:
        while self._flying and self._flying[0][0] <= self.now_us:
            _, _, to, data = heapq.heappop(self._flying)
            to.receive(data, now_us=self.now_us)
        self._drain()

    def _drain(self) -> None:
        for session, log in ((self.server, self.server_log), (self.client, self.client_log)):
            while (event := session.next_event()) is not None:
                log.append((self.now_us, event))
