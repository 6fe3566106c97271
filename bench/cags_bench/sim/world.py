"""Two peers and two links under one virtual clock.

The peers are the same cores that the processes run (:class:`cags_server.session.connection.Connection`,
:class:`cags_client.playback.player.Player`); only the outermost shell differs. Work takes no virtual time, a busy
machine makes nothing late, and two runs are byte-identical.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from cags_common.errors import NetworkError
from cags_shaper.link import WEBSOCKET_OVERHEAD_BYTES, Link, tcp_wire_bytes

MAX_STEPS_WITHOUT_TIME = 10_000
"""A peer that always has work at one instant is broken; raising an error is better than hanging."""


class Peer(Protocol):
    """A peer of the world: a sans-IO core and its jobs."""

    def receive(self, data: bytes, now_us: int) -> None:
        """Receive one message."""

    def data_to_send(self, now_us: int) -> list[bytes]:
        """Messages to write now."""

    def next_timer_us(self) -> int | None:
        """When :meth:`handle_timer` is due; None if no timer is set."""

    def handle_timer(self, now_us: int) -> None:
        """Do what is due at ``now_us``."""


@dataclass
class Direction:
    """One direction of the connection: the sender's backlog and the link."""

    link: Link[bytes]
    on_delivery: Callable[[bytes, int], None]
    header_bytes: int = WEBSOCKET_OVERHEAD_BYTES
    _backlog: deque[bytes] = field(default_factory=deque)

    def write(self, messages: list[bytes], now_us: int) -> bool:
        """Add messages to the backlog and push as many as the link accepts. True if there were any."""
        self._backlog.extend(messages)
        self._push(now_us)
        return bool(messages)

    @property
    def congested(self) -> bool:
        """Whether the sender's socket is full: a stream waits where datagrams would be lost."""
        return bool(self._backlog)

    def deliver(self, now_us: int) -> bool:
        """Deliver what has arrived by ``now_us``; True if anything has."""
        arrived = self.link.pop_due(now_us)
        for data in arrived:
            self.on_delivery(data, now_us)
        self._push(now_us)
        return bool(arrived)

    def next_us(self) -> int | None:
        """When the next message arrives, or the full queue has room again."""
        times = [self.link.next_delivery_us(), self.link.next_room_us() if self._backlog else None]
        return min((time for time in times if time is not None), default=None)

    def _push(self, now_us: int) -> None:
        while self._backlog:
            data = self._backlog[0]
            if not self.link.push(now_us, data, tcp_wire_bytes(len(data) + self.header_bytes)):
                return
            self._backlog.popleft()


class World:
    """Runs a server peer and a client peer until the client has finished."""

    def __init__(
        self,
        server: Peer,
        client: Peer,
        down: Direction,
        up: Direction,
        work: Callable[[int], bool],
        *,
        alarm: Callable[[], int | None] = lambda: None,
    ) -> None:
        """``work(now_us)`` runs the jobs that the peers have ready, and returns whether there were any.

        It may replace peers and directions. ``alarm()`` returns when it must be called next at the latest.
        """
        self.server, self.client, self.down, self.up = server, client, down, up
        self._work, self._alarm = work, alarm
        self.now_us = 0

    def run(self, finished: Callable[[], bool], limit_us: int) -> None:
        """Advance until ``finished()``. Raises :class:`NetworkError` if nothing is due, or after ``limit_us``."""
        while not finished():
            self._settle()
            if finished():
                return
            upcoming = self._next_us()
            if upcoming is None:
                raise NetworkError(f"the simulated stream is stuck at {self.now_us / 1e6:.3f} s: nothing is due")
            if upcoming > limit_us:
                raise NetworkError(
                    f"the simulated stream did not end within {limit_us / 1e6:.1f} s; give the link more capacity"
                )
            self.now_us = max(self.now_us, upcoming)

    def _settle(self) -> None:
        """Exchange messages and run jobs until nothing more happens at this instant."""
        for _ in range(MAX_STEPS_WITHOUT_TIME):
            if not self._step():
                return
        raise NetworkError(f"the simulated peers never become idle at {self.now_us / 1e6:.3f} s")

    def _step(self) -> bool:
        now = self.now_us
        busy = self.down.deliver(now) | self.up.deliver(now)
        for peer in (self.server, self.client):
            timer = peer.next_timer_us()
            if timer is not None and timer <= now:
                peer.handle_timer(now)
                busy = True
        busy |= self._work(now)
        for peer, direction in ((self.server, self.down), (self.client, self.up)):
            if not direction.congested:
                busy |= direction.write(peer.data_to_send(now), now)
        return busy

    def _next_us(self) -> int | None:
        times = [self.server.next_timer_us(), self.client.next_timer_us(), self.down.next_us(), self.up.next_us()]
        times.append(self._alarm())
        return min((time for time in times if time is not None), default=None)
