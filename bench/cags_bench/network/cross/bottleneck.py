"""Flows over one link under one clock: sessions of the product and competing flows.

The link is the shaper's own (:class:`cags_shaper.link.Link`): packets, a drop-tail queue, random loss, delay.
Acknowledgements and clients' messages return after the same delay, without limits or losses.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from cags_bench.network.cross.tcp import Flow, Segment
from cags_bench.network.load import FPS, Arrivals, LoadClient, LoadServer
from cags_common.errors import NetworkError
from cags_server.link import MeasuredLink
from cags_shaper.link import SEGMENT_OVERHEAD_BYTES, Link

SAMPLE_US = 10_000
"""Interval at which the queue is sampled."""

MAX_STEPS = 10_000
"""Largest number of steps at one instant; a participant that needs more is stuck."""


class Rival:
    """A flow that starts at ``start_us``; an endless one represents a long download."""

    def __init__(self, flow: Flow, start_us: int) -> None:
        self.flow, self.start_us = flow, start_us


class Station(Rival):
    """A session of the product over a flow; its clock begins at ``start_us``."""

    def __init__(self, flow: Flow, start_us: int) -> None:
        super().__init__(flow, start_us)
        self.log = Arrivals()
        self.due_us: int | None = start_us
        """When :meth:`step` must be called next; arrivals at the station or its flow move it forward."""
        self.server, self.client = LoadServer(MeasuredLink(), self.log, FPS), LoadClient(self.log)

    def step(self, now_us: int) -> tuple[bool, list[bytes]]:
        """Do what is due. Returns whether there was anything, and the client's messages."""
        if self.due_us is None or now_us < max(self.due_us, self.start_us):
            return False, []
        local_us, busy = now_us - self.start_us, False
        for peer in (self.server, self.client):
            timer_us = peer.next_timer_us()
            if timer_us is not None and timer_us <= local_us:
                peer.handle_timer(local_us)
                busy = True
        while not self.flow.congested and (messages := self.server.data_to_send(local_us)):
            busy = True
            for message in messages:
                self.flow.write(message)
        said = self.client.data_to_send(local_us)
        times = [time for time in (self.server.next_timer_us(), self.client.next_timer_us()) if time is not None]
        self.due_us = self.start_us + min(times) if times else None
        return busy or bool(said), said

    def delivered(self, messages: list[bytes], now_us: int) -> None:
        """Messages have arrived at the client."""
        for message in messages:
            self.client.receive(message, now_us - self.start_us)
        self.due_us = now_us

    def heard(self, message: bytes, now_us: int) -> None:
        """A message has arrived at the server."""
        self.server.receive(message, now_us - self.start_us)
        self.due_us = now_us


class Bottleneck:
    """Runs stations and rivals over ``link``. Deterministic."""

    def __init__(
        self, link: Link[Segment], stations: Sequence[Station], rivals: Sequence[Rival], rate_bps: float
    ) -> None:
        self.queue_us: list[tuple[int, float]] = []
        """(time, delay of a packet arriving now), every :data:`SAMPLE_US`."""
        self._link, self._stations, self._rate_bps = link, stations, rate_bps
        parties: list[Rival] = [*stations, *rivals]
        self._flows = [(party.flow, party.start_us) for party in parties]
        self._of = {id(station.flow): station for station in stations}
        self._delay_us = link.settings.delay_us
        self._acks: deque[tuple[int, Segment]] = deque()
        self._said: deque[tuple[int, Station, bytes]] = deque()
        self._now_us = self._sample_us = 0

    def run(self, until_us: int) -> None:
        """Run until ``until_us``. Raises :class:`NetworkError` if a participant is stuck."""
        while self._now_us <= until_us:
            for _ in range(MAX_STEPS):
                if not self._step(self._now_us):
                    break
            else:
                raise NetworkError(f"the flows do not come to rest at {self._now_us / 1e6:.3f} s")
            self._now_us = max(self._next_us(), self._now_us)

    def _step(self, now_us: int) -> bool:
        busy = self._deliver(now_us)
        while self._acks and self._acks[0][0] <= now_us:
            segment = self._acks.popleft()[1]
            segment.flow.acknowledged(segment, now_us)
            self._wake(segment.flow, now_us)
        while self._said and self._said[0][0] <= now_us:
            _, station, data = self._said.popleft()
            station.heard(data, now_us)
        for station in self._stations:
            did, said = station.step(now_us)
            busy |= did
            self._said.extend((now_us + self._delay_us, station, data) for data in said)
        for flow, start_us in self._flows:
            for segment in flow.segments(now_us) if now_us >= start_us else ():
                self._link.push(now_us, segment, segment.size + SEGMENT_OVERHEAD_BYTES)
                self._wake(flow, now_us)  # its socket has room
                busy = True
        return busy

    def _wake(self, flow: Flow, now_us: int) -> None:
        station = self._of.get(id(flow))
        if station is not None:
            station.due_us = now_us

    def _deliver(self, now_us: int) -> bool:
        while self._sample_us <= now_us:
            self.queue_us.append((self._sample_us, self._link.queued_bytes(now_us) * 8e6 / self._rate_bps))
            self._sample_us += SAMPLE_US
        segments = self._link.pop_due(now_us)
        for segment in segments:
            messages = segment.flow.arrived(segment)
            if messages:
                self._of[id(segment.flow)].delivered(messages, now_us)
            self._acks.append((now_us + self._delay_us, segment))
        return bool(segments)

    def _next_us(self) -> int:
        times = [self._sample_us, self._link.next_delivery_us()]
        times += [queue[0][0] for queue in (self._acks, self._said) if queue]
        times += [station.due_us for station in self._stations]
        for flow, start_us in self._flows:
            next_us = flow.next_us()
            times.append(None if next_us is None else max(next_us, start_us))
        return min(time for time in times if time is not None)
