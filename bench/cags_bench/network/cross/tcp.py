"""A model of one direction of a TCP connection: segments, selective acknowledgements, retransmissions, order.

It models what determines a stream's share beside others: congestion control
(:mod:`cags_bench.network.cross.congestion`), loss detection by the delivery of later segments (RACK,
RFC 8985, on a path that never reorders), a tail probe, the retransmission timeout (RFC 6298, at least 200 ms as in
Linux), and in-order delivery. Every segment is acknowledged separately and no acknowledgement is lost. The receiver's
window is never full, there is no handshake, and acknowledgements are not delayed or coalesced. After a timeout,
segments that the receiver has are not sent again.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from cags_bench.network.cross.congestion import Ack, Congestion
from cags_shaper.link import SEGMENT_BYTES, WEBSOCKET_OVERHEAD_BYTES

NOTSENT_BYTES = 16 * 1024
"""Limit of unsent data in a socket, as in the server (``TCP_NOTSENT_LOWAT``)."""

LEAST_TIMEOUT_US, FIRST_TIMEOUT_US, LONGEST_TIMEOUT_US = 200_000, 1_000_000, 60_000_000
LEAST_PROBE_US = 10_000


@dataclass(eq=False, slots=True)
class Segment:
    """Bytes ``start`` to ``end`` of a flow's stream, sent once; a retransmission is another segment."""

    flow: Flow
    order: int
    start: int
    end: int
    sent_us: int
    delivered: int
    delivered_us: int
    app_limited: bool

    @property
    def size(self) -> int:
        """Payload bytes."""
        return self.end - self.start


class Flow:
    """Sender and receiver of a stream of messages, or of endless bytes (``endless``)."""

    def __init__(self, congestion: Congestion, *, endless: bool = False) -> None:
        self.congestion = congestion
        self.received_bytes = 0
        """Bytes delivered in order."""
        self.retransmitted = 0
        """Number of retransmitted segments."""
        self._endless = endless
        self._written = self._sent = 0  # end of the written data, and of the data sent once
        self._messages: deque[tuple[int, bytes]] = deque()
        self._lost: deque[tuple[int, int]] = deque()
        self._outstanding: deque[Segment] = deque()
        self._in_flight = self._order = self._recovered_order = 0
        self._arrived: dict[int, int] = {}  # out of order: start -> end
        self._delivered = self._delivered_us = self._round_delivered = self._limited_until = 0
        self._next_send_us = 0.0
        self._srtt_us = self._rttvar_us = 0.0
        self._heard_us = self._silences = 0

    @property
    def congested(self) -> bool:
        """Whether the socket is full."""
        return self._written - self._sent >= NOTSENT_BYTES

    def write(self, message: bytes) -> None:
        """Accept a message; a WebSocket header is added."""
        self._written += len(message) + WEBSOCKET_OVERHEAD_BYTES
        self._messages.append((self._written, message))

    def segments(self, now_us: int) -> list[Segment]:
        """Segments to send now."""
        self._time_out(now_us)
        out: list[Segment] = []
        while now_us >= self._next_send_us and (piece := self._next_piece()) is not None:
            out.append(self._send(piece, now_us))
            pacing_bps = self.congestion.pacing_bps
            if pacing_bps is not None:
                begun_us = max(self._next_send_us, float(now_us))
                self._next_send_us = begun_us + (piece[1] - piece[0]) * 8e6 / pacing_bps
        return out

    def next_us(self) -> int | None:
        """When :meth:`segments` should be called next, unless something arrives."""
        times = []
        if self._outstanding:
            times.append(self._heard_us + self._patience_us())
        if self._may_send() is not None:
            times.append(math.ceil(self._next_send_us))
        return min(times, default=None)

    def acknowledged(self, segment: Segment, now_us: int) -> None:
        """``segment`` was acknowledged."""
        in_flight = self._in_flight
        lost = False
        while self._outstanding and self._outstanding[0].order < segment.order:
            lost |= self._lose(self._outstanding.popleft())
        if not self._outstanding or self._outstanding[0] is not segment:
            return  # a timeout had given it up
        self._outstanding.popleft()
        self._in_flight -= segment.size
        self._heard_us, self._silences = now_us, 0
        self._time(now_us - segment.sent_us)
        self._delivered += segment.size
        self._delivered_us = now_us
        began = segment.delivered >= self._round_delivered
        if began:
            self._round_delivered = self._delivered
        rate_bps = (self._delivered - segment.delivered) * 8e6 / max(now_us - segment.delivered_us, 1)
        if lost:
            self.congestion.on_loss()
        self.congestion.on_ack(
            Ack(now_us, segment.size, now_us - segment.sent_us, in_flight, rate_bps, segment.app_limited, began)
        )

    def arrived(self, segment: Segment) -> list[bytes]:
        """A segment has left the link; returns the messages completed by it."""
        if segment.start >= self.received_bytes:
            self._arrived[segment.start] = segment.end
        while (end := self._arrived.pop(self.received_bytes, None)) is not None:
            self.received_bytes = end
        out = []
        while self._messages and self._messages[0][0] <= self.received_bytes:
            out.append(self._messages.popleft()[1])
        return out

    def _may_send(self) -> tuple[int, int] | None:
        """The bytes to send next if pacing allows, lost ones first."""
        while self._lost and self._has(self._lost[0][0]):
            self._lost.popleft()
        if self._lost:
            piece = self._lost[0]
        else:
            end = self._sent + SEGMENT_BYTES if self._endless else min(self._written, self._sent + SEGMENT_BYTES)
            piece = self._sent, end
        if piece[0] >= piece[1]:
            return None
        fits = self._in_flight + piece[1] - piece[0] <= self.congestion.window_bytes
        return piece if fits or not self._outstanding else None

    def _next_piece(self) -> tuple[int, int] | None:
        piece = self._may_send()
        if piece is None:
            if not self._endless and not self._lost and self._sent >= self._written:
                self._limited_until = self._delivered + max(self._in_flight, 1)
            return None
        if self._lost:
            self._lost.popleft()
            self.retransmitted += 1
        else:
            self._sent = piece[1]
        return piece

    def _send(self, piece: tuple[int, int], now_us: int) -> Segment:
        if not self._outstanding:
            self._delivered_us = now_us
        limited = self._limited_until > self._delivered
        segment = Segment(self, self._order, *piece, now_us, self._delivered, self._delivered_us, limited)
        self._order += 1
        self._outstanding.append(segment)
        self._in_flight += segment.size
        self._heard_us = now_us
        return segment

    def _lose(self, segment: Segment) -> bool:
        """Schedule a retransmission; returns whether it is the first loss of a round trip."""
        self._in_flight -= segment.size
        self._lost.append((segment.start, segment.end))
        first = segment.order >= self._recovered_order
        if first:
            self._recovered_order = self._order
        return first

    def _has(self, start: int) -> bool:
        return start < self.received_bytes or start in self._arrived

    def _time(self, rtt_us: int) -> None:
        if not self._srtt_us:
            self._srtt_us, self._rttvar_us = float(rtt_us), rtt_us / 2
            return
        self._rttvar_us += (abs(self._srtt_us - rtt_us) - self._rttvar_us) / 4
        self._srtt_us += (rtt_us - self._srtt_us) / 8

    def _patience_us(self) -> int:
        """Waiting time until a probe, and after it until the timeout."""
        if not self._silences and self._srtt_us:
            return round(max(2 * self._srtt_us, LEAST_PROBE_US))
        known_us: float = self._srtt_us + 4 * self._rttvar_us if self._srtt_us else FIRST_TIMEOUT_US
        doubled = max(known_us, LEAST_TIMEOUT_US) * float(2 ** min(max(self._silences - 1, 0), 10))
        return round(min(doubled, LONGEST_TIMEOUT_US))

    def _time_out(self, now_us: int) -> None:
        if not self._outstanding or now_us < self._heard_us + self._patience_us():
            return
        self._silences += 1
        last = self._outstanding[-1]
        if self._silences == 1 and self._srtt_us:  # probe the tail, regardless of the window
            self._outstanding.pop()
            self._in_flight -= last.size
            self._lost.appendleft((last.start, last.end))
            self._next_send_us = float(now_us)
            return
        while self._outstanding:
            self._lose(self._outstanding.popleft())
        self._lost = deque(sorted(self._lost))
        self._recovered_order = self._order
        self._next_send_us = float(now_us)
        self.congestion.on_timeout()
