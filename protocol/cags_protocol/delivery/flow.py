"""Credit and delivery accounting of what is on its way to a client.

At most ``window_us`` of queueing delay times the rate is unacknowledged, so that what the server decides next is never
stuck behind more than that. Rate samples follow draft-cheng-iccrg-delivery-rate-estimation: bytes delivered between the
sending of a packet and its arrival, over the longer of the send and the arrival interval.

Arrivals are those that the client's clock tells, brought to the server's by the shortest one-way delay of late. By the
time at which acknowledgements are read, a server that is short of processor time would take its own delay for a queue
on the link and send less and less. The window alone counts such delay in: it must last until the server looks again.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass
from math import ceil, inf

from cags_common.errors import ProtocolError
from cags_protocol.delivery.competition import Competition
from cags_protocol.delivery.round_trips import RoundTrips
from cags_protocol.delivery.send_queue import Entry
from cags_protocol.events import Stance
from cags_protocol.wire import limits
from cags_protocol.wire.messages import SeqRange

REORDER_PACKETS = 64
"""A packet is lost when one sent so many later is acknowledged: it was damaged, and the client dropped it."""

PACKET_US, LEAST_PACKET_BYTES = 60_000, 1_448
"""Longest time that a packet may occupy the link, and size of the smallest packet (a TCP segment). Nothing can overtake
a packet on its way, and on a link of 200 kbit/s a packet of the largest size takes a third of a second.
"""

MIN_WINDOW_PACKETS = 2
"""Least credit: one packet on the wire, one to follow it."""

RESERVE_PACKETS = 2
"""Credit for reference pictures and what is as urgent alone, so that they never wait for tiles to be acknowledged."""

OWN_QUEUES = 3.0
"""Connections of this kind hold at most so many times the queue that the credit window allows; probing adds to it."""

SLOW_BPS = 300e3
"""On a slower link, packets sent before its rate was known make a long queue by themselves, so a queue is not taken for
another flow's.
"""

PACING_GAIN = 1.5
"""Packets leave at most so many times as fast as the link is thought to be: credit that comes at once is spread out,
and a reference that is queued meanwhile does not wait on the link behind all of it.
"""

MAX_PACING_US = 100_000
"""No packet waits for longer: after an outage the link is thought to be far slower than it is."""


@dataclass(frozen=True, slots=True)
class Flight:
    """One packet on its way, with the state of delivery when it was sent."""

    entry: Entry
    size: int
    sent_us: int
    first_sent_us: int
    delivered_bytes: int
    delivered_us: int
    app_limited: bool


@dataclass(frozen=True, slots=True)
class AckResult:
    """What an acknowledgement changed."""

    acked: list[tuple[int, Flight]]
    lost: list[tuple[int, Flight]]
    delivery_rate_bps: float | None
    app_limited: bool


class FlowControl:
    """Packets in flight on one connection."""

    def __init__(self, window_us: int, rate_bps: float, now_us: int) -> None:
        self._window_us = window_us
        self.rate_bps = rate_bps
        """What the bandwidth estimator thinks the link carries; sizes the window."""
        self._flights: OrderedDict[int, Flight] = OrderedDict()
        self._next_seq = 1
        self._app_limited_until = 0
        self._delivered_us = self._first_sent_us = now_us
        self.round_trips = RoundTrips()
        self._competition = Competition()
        self._ahead_bytes, self._ahead_us = 0.0, now_us - window_us  # more than the pace allows, and since when
        self.in_flight_bytes = 0
        self.delivered_bytes = 0
        self.sent_bytes = 0
        self.lost_bytes = 0

    @property
    def next_seq(self) -> int:
        """Number of the next packet."""
        return self._next_seq

    @property
    def stance(self) -> Stance:
        """How this connection responds to a queue on the link."""
        return self._competition.stance

    @property
    def window_bytes(self) -> int:
        """Bytes that may be unacknowledged: the link's own content, ``window_us`` of queue, and room for jitter.

        Without that room a busy machine, whose round trips jump by tens of milliseconds, would never fill its link. A
        queue that another flow holds counts as the link's own content; otherwise the longer it is, the less of the
        link this connection could use.
        """
        trips = self.round_trips
        if self.stance is Stance.GIVE_WAY:
            return self._bytes_in(self._window_us + trips.shortest_us + trips.jitter_as_read_us)
        return self.packet_bytes + self._bytes_in(self._window_us + trips.newest_us + trips.jitter_as_read_us)

    @property
    def packet_bytes(self) -> int:
        """Largest size of the next packet."""
        return min(max(int(self.rate_bps * PACKET_US / 8e6), LEAST_PACKET_BYTES), limits.PACKET_BYTES)

    @property
    def _min_window_bytes(self) -> int:
        return MIN_WINDOW_PACKETS * self.packet_bytes

    def _own_queue_us(self) -> tuple[float, float]:
        """The longest queue that connections of this kind usually make, and what the least credit may add to it."""
        if self.rate_bps < SLOW_BPS:
            return inf, 0.0
        return (
            OWN_QUEUES * self._window_us + self.round_trips.jitter_as_read_us,
            self._min_window_bytes * 8e6 / self.rate_bps,
        )

    def _bytes_in(self, time_us: float) -> int:
        return max(self._min_window_bytes, int(self.rate_bps * time_us / 8e6))

    def has_credit(self, *, reserve: bool = False) -> bool:
        """Whether another packet may be sent now; ``reserve``: it may use the reserve."""
        reserve_bytes = RESERVE_PACKETS * self.packet_bytes if reserve else 0
        return self.in_flight_bytes + self.packet_bytes <= self.window_bytes + reserve_bytes

    @property
    def paced_until_us(self) -> int:
        """When the next packet may leave, if there is credit for it, of the server's clock; at once where nothing is in
        flight: too low an estimate must not hold an empty link up.
        """
        if not self._flights:
            return self._ahead_us
        return self._ahead_us + min(ceil(self._ahead_bytes * 8e6 / (PACING_GAIN * self.rate_bps)), MAX_PACING_US)

    def _pace_bytes(self, time_us: float) -> float:
        return PACING_GAIN * self.rate_bps * time_us / 8e6

    def _ahead(self, now_us: int) -> float:
        """By how many bytes more was sent than the pace allows; negative: by how many less."""
        return self._ahead_bytes - self._pace_bytes(now_us - self._ahead_us)

    def on_sent(self, entry: Entry, size: int, now_us: int) -> None:
        """Account for packet ``next_seq``, which carries ``size`` bytes of ``entry``."""
        most = self._pace_bytes(MAX_PACING_US)
        self._ahead_bytes = min(max(self._ahead(now_us), -self._pace_bytes(self._window_us)), most) + size
        self._ahead_us = now_us
        if not self._flights:
            self._first_sent_us = self._delivered_us = now_us
        self._flights[self._next_seq] = Flight(
            entry, size, now_us, self._first_sent_us, self.delivered_bytes, self._delivered_us,
            self._app_limited_until > self.delivered_bytes,
        )  # fmt: skip
        self._next_seq += 1
        self.in_flight_bytes += size
        self.sent_bytes += size

    def on_idle(self) -> None:
        """The queue ran dry with credit left: what is in flight now does not show what the link can do."""
        self._app_limited_until = self.delivered_bytes + self.in_flight_bytes + 1

    def on_ack(self, ranges: Iterable[SeqRange], received_us: int, delay_us: int, now_us: int) -> AckResult | None:
        """Take the acknowledged packets out; None if there are no new ones. Raises :class:`ProtocolError`.

        The newest packet arrived at ``received_us`` of the client's clock, ``delay_us`` before this was sent.
        """
        ranges = tuple(ranges)
        largest = max((r.last for r in ranges), default=0)
        if largest >= self._next_seq:
            raise ProtocolError(f"ack of packet {largest}, but only {self._next_seq - 1} were sent")
        acked = self._take_acked(ranges)
        if not acked:
            return None
        self.delivered_bytes += sum(flight.size for _, flight in acked)
        newest = acked[-1][1]
        self.round_trips.note(now_us, max(now_us - newest.sent_us - delay_us, 0), received_us - newest.sent_us)
        rtt_us = self.round_trips.newest_us
        arrived_us = max(newest.sent_us + rtt_us, self._delivered_us)
        rate = self._rate_sample(newest, arrived_us)
        own_us, least_us = self._own_queue_us()
        self._competition.note(now_us, rtt_us, own_us, sure_us=own_us + least_us)
        self._delivered_us, self._first_sent_us = arrived_us, newest.sent_us
        return AckResult(acked, self._take_lost(largest), rate, newest.app_limited)

    def drain(self) -> list[Flight]:
        """Take out everything that is in flight: the connection is over."""
        return [self._remove(seq) for seq in list(self._flights)]

    def _rate_sample(self, newest: Flight, arrived_us: int) -> float | None:
        send_us = newest.sent_us - newest.first_sent_us
        interval_us = max(send_us, arrived_us - newest.delivered_us)
        return (self.delivered_bytes - newest.delivered_bytes) * 8e6 / interval_us if interval_us > 0 else None

    def _take_acked(self, ranges: tuple[SeqRange, ...]) -> list[tuple[int, Flight]]:
        acked: list[tuple[int, Flight]] = []
        for wanted in sorted(ranges, key=lambda r: r.first):
            for seq in list(self._flights):
                if seq > wanted.last:
                    break
                if seq >= wanted.first:
                    acked.append((seq, self._remove(seq)))
        return acked

    def _take_lost(self, largest: int) -> list[tuple[int, Flight]]:
        lost: list[tuple[int, Flight]] = []
        while self._flights and next(iter(self._flights)) + REORDER_PACKETS < largest:
            seq = next(iter(self._flights))
            lost.append((seq, self._remove(seq)))
            self.lost_bytes += lost[-1][1].size
        return lost

    def _remove(self, seq: int) -> Flight:
        flight = self._flights.pop(seq)
        self.in_flight_bytes -= flight.size
        return flight
