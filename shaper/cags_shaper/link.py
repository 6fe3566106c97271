"""A link as a pure object: packets in, delivery times out. No clock, no sockets.

Exact to mahimahi's rule: a packet that is queued before an opportunity's time may use it; an opportunity carries 1,504
bytes of whatever is queued, across packet borders, and what it has left when the queue runs dry is lost. The queue is
drop-tail; the packet whose first byte has been served has left it. First in, first out, so a packet's delivery time is
known when it is pushed:

    start  = max(end of the packet before, 1504 x opportunities up to now)
    finish = start + size;  delivered at opportunity ceil(finish / 1504)
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Sized
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

from cags_common.errors import ConfigError
from cags_common.passes import LinkEffect
from cags_shaper.trace import NEVER_US, OPPORTUNITY_BYTES, Trace

T = TypeVar("T")

SEGMENT_BYTES = 1448
"""Payload of a full TCP segment on Ethernet, with time stamps."""

SEGMENT_OVERHEAD_BYTES = 52
"""IPv4 and TCP headers of a segment, with time stamps."""

WEBSOCKET_OVERHEAD_BYTES = 4
"""Frame header of a server's WebSocket message of 126 to 65,535 bytes (a client's has four more, the mask)."""


def tcp_wire_bytes(payload_bytes: int) -> int:
    """Bytes that a link carries for ``payload_bytes`` of a TCP stream."""
    return payload_bytes + SEGMENT_OVERHEAD_BYTES * math.ceil(payload_bytes / SEGMENT_BYTES)


@dataclass(frozen=True)
class LinkSettings:
    """What a link does besides its trace. An effect that is not named is absent and costs nothing."""

    delay_us: int = 0
    """Propagation delay, one way, added after the rate."""
    jitter_us: int = 0
    """Mean of an exponential extra delay; packets are not reordered."""
    loss: float = 0.0
    """Probability that a packet vanishes before the queue."""
    queue_bytes: int | None = None
    """Drop-tail bound of the queue in bytes; None: unbounded."""
    queue_packets: int | None = None
    """Drop-tail bound of the queue in packets; None: unbounded."""
    seed: int = 0
    """Seed of jitter and loss."""
    cap_bps: float | None = None
    """Highest rate, whatever the trace allows; None: no cap."""

    def __post_init__(self) -> None:
        for name in ("delay_us", "jitter_us"):
            if not 0 <= getattr(self, name) <= 60_000_000:
                raise ConfigError(f"{name} = {getattr(self, name)} must lie in [0, 60000000]")
        if not 0 <= self.loss < 1:
            raise ConfigError(f"loss = {self.loss} must lie in [0, 1)")
        for name in ("queue_bytes", "queue_packets"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ConfigError(f"{name} = {value} must be at least 1, or not given")
        if self.cap_bps is not None and not 1e3 <= self.cap_bps <= 1e12:
            raise ConfigError(f"cap_bps = {self.cap_bps} must lie in [1000, 1e12], or not be given")

    def effects(self, *, rated: bool) -> frozenset[LinkEffect]:
        """What is named here and so happens; ``rated``: the link has a trace."""
        named = {
            LinkEffect.RATE: rated,
            LinkEffect.DELAY: self.delay_us > 0,
            LinkEffect.JITTER: self.jitter_us > 0,
            LinkEffect.LOSS: self.loss > 0,
            LinkEffect.QUEUE: self.queue_bytes is not None or self.queue_packets is not None,
            LinkEffect.CAP: self.cap_bps is not None,
        }
        return frozenset(effect for effect, on in named.items() if on)


@dataclass
class LinkCounts:
    """What passed a link so far."""

    accepted_bytes: int = 0
    accepted_packets: int = 0
    delivered_bytes: int = 0
    delivered_packets: int = 0
    dropped_bytes: int = 0
    dropped_packets: int = 0
    lost_bytes: int = 0
    lost_packets: int = 0


class Link(Generic[T]):
    """One direction of a link. ``trace`` None has no rate limit. Times are since the link's start, never falling."""

    def __init__(self, trace: Trace | None, settings: LinkSettings | None = None) -> None:
        self.trace, self.settings = trace, settings or LinkSettings()
        self.effects = self.settings.effects(rated=trace is not None)
        self.counts = LinkCounts()
        self._random = random.Random(self.settings.seed)  # noqa: S311 - a simulation, not a secret
        self._position = 0  # bytes of opportunities used or passed, by the end of the last packet
        self._queue: deque[tuple[int, int]] = deque()  # (leaves the queue at, size)
        self._queued_bytes = 0
        self._coming: deque[tuple[int, int, T]] = deque()  # (delivered at, size, data)
        self._last_us = 0
        self._cap_free_us = 0.0  # when the capped sender is done with what it has

    def change(self, **settings: Any) -> None:
        """Change settings by name, for packets pushed from now on; those on their way keep their times."""
        self.settings = replace(self.settings, **settings)
        self.effects = self.settings.effects(rated=self.trace is not None)

    def push(self, now_us: int, data: T, size_bytes: int | None = None) -> bool:
        """Offer a packet, or a piece of a stream, of ``size_bytes`` (default: ``len(data)``).

        False if the queue is full: a packet is then dropped (drop-tail), a stream's piece offered again at
        :meth:`next_room_us`.
        """
        size_bytes = len(data) if size_bytes is None and isinstance(data, Sized) else size_bytes
        if size_bytes is None or size_bytes < 1:
            raise ValueError(f"size_bytes = {size_bytes} must be at least 1")
        self._leave(now_us)
        if LinkEffect.LOSS in self.effects and self._random.random() < self.settings.loss:
            self.counts.lost_bytes += size_bytes
            self.counts.lost_packets += 1
            return True
        if LinkEffect.QUEUE in self.effects and not self._has_room(size_bytes):
            self.counts.dropped_bytes += size_bytes
            self.counts.dropped_packets += 1
            return False
        self._accept(now_us, data, size_bytes)
        return True

    def next_delivery_us(self) -> int | None:
        """When the next packet comes out; None when none is on its way (or none ever, after the end of the trace)."""
        return self._coming[0][0] if self._coming and self._coming[0][0] < NEVER_US else None

    def next_room_us(self) -> int | None:
        """When the next packet leaves the queue: the time to offer again what was refused; None when it is empty."""
        return self._queue[0][0] if self._queue and self._queue[0][0] < NEVER_US else None

    def pop_due(self, now_us: int) -> list[T]:
        """What is delivered up to ``now_us``, in order."""
        out: list[T] = []
        while self._coming and self._coming[0][0] <= now_us:
            _, size, data = self._coming.popleft()
            self.counts.delivered_bytes += size
            self.counts.delivered_packets += 1
            out.append(data)
        return out

    def queued_bytes(self, now_us: int) -> int:
        """Bytes in the queue at ``now_us``, without the packet being served."""
        self._leave(now_us)
        return self._queued_bytes

    @property
    def coming_packets(self) -> int:
        """Packets accepted and not delivered."""
        return len(self._coming)

    def _leave(self, now_us: int) -> None:
        while self._queue and self._queue[0][0] <= now_us:
            self._queued_bytes -= self._queue.popleft()[1]

    def _has_room(self, size: int) -> bool:
        s = self.settings
        return (s.queue_bytes is None or self._queued_bytes + size <= s.queue_bytes) and (
            s.queue_packets is None or len(self._queue) < s.queue_packets
        )

    def _accept(self, now_us: int, data: T, size: int) -> None:
        served_us = finished_us = now_us
        if self.trace is not None:
            start = max(self._position, OPPORTUNITY_BYTES * self.trace.count_until(now_us))
            self._position = start + size
            served_us = self.trace.time_of(start // OPPORTUNITY_BYTES + 1)
            finished_us = self.trace.time_of(-(-self._position // OPPORTUNITY_BYTES))
        if LinkEffect.CAP in self.effects and self.settings.cap_bps is not None:
            start_us = max(self._cap_free_us, now_us)
            self._cap_free_us = start_us + size * 8e6 / self.settings.cap_bps
            served_us = max(served_us, math.ceil(start_us))
            finished_us = max(finished_us, math.ceil(self._cap_free_us))
        if served_us > now_us:
            self._queue.append((served_us, size))
            self._queued_bytes += size
        self.counts.accepted_bytes += size
        self.counts.accepted_packets += 1
        self._coming.append((self._propagate(finished_us), size, data))

    def _propagate(self, finished_us: int) -> int:
        if finished_us >= NEVER_US:
            return NEVER_US
        arrival_us = finished_us + self.settings.delay_us
        if LinkEffect.JITTER in self.effects:
            arrival_us += round(self._random.expovariate(1.0 / self.settings.jitter_us))
        self._last_us = max(self._last_us, arrival_us)
        return self._last_us
