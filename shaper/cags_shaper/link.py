"""A link as a pure object: packets in, delivery times out. No clock, no sockets.

It follows mahimahi's rule exactly. A packet that is queued before an opportunity may use it. An opportunity carries
1,504 queued bytes, across packet borders; its remainder is lost when the queue is empty. The queue is drop-tail, and a
packet leaves it when its first byte is served. The order is first in, first out, so a packet's delivery time is known
when it is pushed:

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
    """Bytes on the link for ``payload_bytes`` of a TCP stream."""
    return payload_bytes + SEGMENT_OVERHEAD_BYTES * math.ceil(payload_bytes / SEGMENT_BYTES)


@dataclass(frozen=True)
class LinkSettings:
    """Effects of a link besides its trace. An effect that is not set is absent and costs nothing."""

    delay_us: int = 0
    """Propagation delay, one way, added after the rate."""
    jitter_us: int = 0
    """Mean of an exponential extra delay; packets are not reordered."""
    loss: float = 0.0
    """Probability that a packet is lost before the queue."""
    queue_bytes: int | None = None
    """Size limit of the drop-tail queue in bytes; None: unlimited."""
    queue_packets: int | None = None
    """Size limit of the drop-tail queue in packets; None: unlimited."""
    seed: int = 0
    """Seed of jitter and loss."""
    cap_bps: float | None = None
    """Upper limit of the rate in addition to the trace; None: no limit."""

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
        """The active effects; ``rated`` is true if the link has a trace."""
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
    """Totals of a link."""

    accepted_bytes: int = 0
    accepted_packets: int = 0
    delivered_bytes: int = 0
    delivered_packets: int = 0
    dropped_bytes: int = 0
    dropped_packets: int = 0
    lost_bytes: int = 0
    lost_packets: int = 0


class Link(Generic[T]):
    """One direction of a link, unlimited if ``trace`` is None. Times are relative to its start and never fall."""

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
        self._cap_free_us = 0.0  # when the capped sender will have sent everything

    def change(self, **settings: Any) -> None:
        """Change settings by name for packets pushed from now on; packets in flight keep their times."""
        self.settings = replace(self.settings, **settings)
        self.effects = self.settings.effects(rated=self.trace is not None)

    def capacity_bps(self, start_us: int, end_us: int) -> float | None:
        """What trace and cap allow in (start_us, end_us], bits a second; None: neither limits it. A cap counts as it is
        set now. Raises :class:`ValueError` for an empty interval of a trace.
        """
        limits = [] if self.trace is None else [self.trace.mean_bps(start_us, end_us)]
        if self.settings.cap_bps is not None:
            limits.append(self.settings.cap_bps)
        return min(limits, default=None)

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
        """Time of the next delivery; None if no packet is in flight, or after the end of the trace."""
        return self._coming[0][0] if self._coming and self._coming[0][0] < NEVER_US else None

    def next_room_us(self) -> int | None:
        """Time when the next packet leaves the queue and a refused one may be offered again; None if it is empty."""
        return self._queue[0][0] if self._queue and self._queue[0][0] < NEVER_US else None

    def pop_due(self, now_us: int) -> list[T]:
        """Remove and return the data delivered up to ``now_us``, in order."""
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
