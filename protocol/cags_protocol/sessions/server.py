"""The server's side of a session."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from cags_common.errors import ProtocolError
from cags_protocol import events as ev
from cags_protocol.delivery.flow import AckResult, Flight, FlowControl
from cags_protocol.delivery.send_queue import Entry, SendQueue
from cags_protocol.sessions.base import Session, SessionTimers, UnexpectedMessageError
from cags_protocol.sessions.states import SERVER_TABLE, State
from cags_protocol.sessions.tracing import EventTrace
from cags_protocol.wire import limits
from cags_protocol.wire.encoding import VersionError, printable
from cags_protocol.wire.messages import (
    Abandon,
    Ack,
    Control,
    Hello,
    KeyframeRequest,
    Message,
    PoseBatch,
    Refusal,
    RefusalCode,
    Welcome,
)

PACING_STEP_US = 5_000
"""Packets that wait for their time alone leave in steps of this: a timer for each would cost more than it brings."""

ENDS_OF_THEIR_OWN = frozenset({RefusalCode.MALFORMED, RefusalCode.UNEXPECTED, RefusalCode.TIMEOUT})
"""Refusals that :class:`cags_protocol.events.Closed` tells apart; every other one is "refused" there."""


@dataclass(frozen=True)
class ServerSessionSettings:
    """Bounds and times of a server's sessions."""

    timers: SessionTimers = field(default_factory=SessionTimers)
    window_us: int = 20_000
    """Queueing delay that unacknowledged data may cause, beside the room for the round trip's jitter."""
    initial_rate_bps: float = 4e6
    """Rate assumed until the bandwidth estimator speaks."""
    max_queue_bytes: int = 16 * 1024 * 1024
    """Bytes that may wait in the queue of one client."""
    max_queue_messages: int = 8192
    """Messages that may wait in the queue of one client."""


class ServerSession(Session[ev.ServerEvent]):
    """One client, as the server sees it. All times are the server's clock unless named otherwise."""

    def __init__(
        self, settings: ServerSessionSettings | None = None, *, now_us: int, trace: EventTrace | None = None
    ) -> None:
        """``trace`` hears of every step of sending (:mod:`cags_protocol.sessions.tracing`); None: nobody does."""
        self._settings = settings or ServerSessionSettings()
        self._trace = trace
        super().__init__(SERVER_TABLE, self._settings.timers, now_us=now_us)
        self._now_us = now_us
        self._queue = SendQueue(self._settings.max_queue_bytes, self._settings.max_queue_messages, self._on_drop)
        self._flow = FlowControl(self._settings.window_us, self._settings.initial_rate_bps, now_us)
        self._abandoned: list[int] = []
        self._next_packet_us: int | None = None  # when what waits for its time alone may leave

    # ------------------------------------------------------------------------------------------------------- decisions

    def accept(self, welcome: Welcome, *, now_us: int) -> None:
        """Open the session, after :class:`Joined`; nothing happens if it has ended in the meantime."""
        if self.closed:
            return
        if self._state is not State.DECIDING:
            raise ProtocolError(f"accept is possible once after Hello, not in state {self._state.value}")
        self._state = State.OPEN
        self._say(welcome, now_us)

    def refuse(self, code: RefusalCode, field: str, message: str, *, now_us: int) -> None:
        """End the session for a reason that the client is told. Possible at any time."""
        if not self.closed:
            self._say(Refusal(code.value, printable(field), printable(message)), now_us)
            self._close(code.value if code in ENDS_OF_THEIR_OWN else "refused", message, now_us)

    def queue(self, outgoing: ev.Outgoing, *, now_us: int) -> None:
        """Queue a message by value; it ends in exactly one :class:`Delivered` or :class:`Dropped` event."""
        self._now_us = now_us
        if self._state is not State.OPEN:
            self._emit(ev.Dropped(outgoing, "closed", 0, now_us))
            return
        self._queue.put(outgoing)
        if self._trace is not None:
            self._trace.queued(now_us, outgoing, self._queue.queued_bytes)

    def cancel(self, match: Callable[[ev.Outgoing], bool], *, now_us: int, started: bool = True) -> None:
        """Drop whatever ``match`` names and is not sent to its end; without ``started``, not begun."""
        self._now_us = now_us
        self._queue.cancel(match, started=started)

    # --------------------------------------------------------------------------------------------------------- sending

    @property
    def rate_hint_bps(self) -> float:
        """What the bandwidth estimator thinks the link carries; it sizes the credit window."""
        return self._flow.rate_bps

    @rate_hint_bps.setter
    def rate_hint_bps(self, rate_bps: float) -> None:
        self._flow.rate_bps = rate_bps

    @property
    def queued_bytes(self) -> int:
        """Bytes that wait in the queue."""
        return self._queue.queued_bytes

    @property
    def in_flight_bytes(self) -> int:
        """Bytes sent and not acknowledged."""
        return self._flow.in_flight_bytes

    def data_to_send(self, now_us: int, max_bytes: int | None = None) -> list[bytes]:
        """Packets that may be written now, most valuable first; about ``max_bytes`` of data if given.

        One packet comes at least, credit allowing. Write them before asking again: order is decided late.
        """
        self._now_us = now_us
        self._queue.expire(now_us)
        self._tell_abandoned(now_us)
        out = list(self._urgent)
        self._urgent.clear()
        taken = 0
        while self._state is State.OPEN and (max_bytes is None or taken == 0 or taken < max_bytes):
            packet = self._next_packet(now_us)
            if packet is None:
                break
            taken += len(packet)
            out.append(packet)
        if out:
            self._said_us = now_us
        return out

    def next_timer_us(self) -> int | None:
        """See :class:`Session`; also when the next packet may leave, and when a queued message becomes stale."""
        every = super().next_timer_us(), self._queue.next_deadline_us(), self._next_packet_us
        times = [t for t in every if t is not None]
        return min(times) if times and not self.closed else None

    def handle_timer(self, *, now_us: int) -> None:
        """See :class:`Session`. Then ask for data to send: a packet may be due."""
        self._now_us = now_us
        self._queue.expire(now_us)
        if self._next_packet_us is not None and self._next_packet_us <= now_us:
            self._next_packet_us = None
        super().handle_timer(now_us=now_us)

    def _next_packet(self, now_us: int) -> bytes | None:
        self._next_packet_us = None
        entry = self._queue.peek()
        if entry is None:
            if self._flow.has_credit():
                self._flow.on_idle()
            return None
        if not self._flow.has_credit(reserve=entry.hurries):
            return None
        if not entry.hurries and now_us < self._flow.paced_until_us:
            self._next_packet_us = max(self._flow.paced_until_us, now_us + PACING_STEP_US)
            return None
        packet = self._queue.take_fragment(entry, self._flow.next_seq, self._flow.packet_bytes)
        if self._trace is not None:
            self._trace.sent(now_us, self._flow.next_seq, entry, len(packet), self._flow)
        self._flow.on_sent(entry, len(packet), now_us)
        if entry.finished:
            self._emit(ev.Sent(entry.outgoing, now_us))
        return packet

    def _tell_abandoned(self, now_us: int) -> None:
        while self._abandoned:
            some = tuple(self._abandoned[: limits.MAX_PARTIAL_MESSAGES])
            del self._abandoned[: limits.MAX_PARTIAL_MESSAGES]
            self._say(Abandon(some), now_us)

    # ------------------------------------------------------------------------------------------------------- receiving

    def _on_message(self, message: Message, payload: memoryview, now_us: int) -> None:
        self._now_us = now_us
        match message:
            case Hello():
                self._emit(ev.Joined(message))
            case PoseBatch():
                self._emit(ev.PosesReceived(message.samples, now_us, message.cadence_permille))
            case Ack():
                self._on_ack(message, now_us)
            case Control():
                self._emit(ev.ControlReceived(message, now_us))
            case KeyframeRequest():
                self._emit(ev.KeyframeRequested(message.reference_seq))

    def _on_ack(self, ack: Ack, now_us: int) -> None:
        result = self._flow.on_ack(ack.ranges, ack.received_us, ack.delay_us, now_us)
        if result is not None:
            self._on_arrivals(ack, result, now_us)
        if ack.evicted:  # after what arrived: it may have been discarded at once
            self._emit(ev.Evicted(ack.evicted))

    def _on_arrivals(self, ack: Ack, result: AckResult, now_us: int) -> None:
        trips = self._flow.round_trips
        sample = ev.AckSample(
            now_us=now_us,
            newly_delivered_bytes=sum(flight.size for _, flight in result.acked),
            rtt_us=trips.newest_us,
            app_limited=result.app_limited,
            delivery_rate_bps=result.delivery_rate_bps,
            in_flight_bytes=self._flow.in_flight_bytes,
            queued_bytes=self._queue.queued_bytes,
            undecoded_bytes=ack.buffered_bytes,
            shortest_rtt_us=trips.shortest_us,
            jitter_us=trips.jitter_us,
            stance=self._flow.stance,
        )
        if self._trace is not None:
            self._trace.acknowledged(sample)
        self._emit(ev.Acknowledged(sample))
        for seq, flight in result.acked:
            self._on_packet_acked(seq, flight, now_us)
        for _, flight in result.lost:
            self._on_packet_lost(flight, now_us)

    def _on_packet_acked(self, seq: int, flight: Flight, now_us: int) -> None:
        entry = flight.entry
        entry.unacked.discard(seq)
        if entry.finished and not entry.unacked and not entry.settled:
            entry.settled = True
            if self._trace is not None:
                self._trace.delivered(now_us, entry.outgoing)
            self._emit(ev.Delivered(entry.outgoing, now_us))

    def _on_packet_lost(self, flight: Flight, now_us: int) -> None:
        entry = flight.entry
        if entry.settled:
            return
        if entry.finished:
            self._settle_dropped(entry, "lost", now_us)
        else:
            self._queue.drop(entry, "lost")

    def _on_drop(self, entry: Entry, reason: str) -> None:
        if entry.started:
            self._abandoned.append(entry.ident)
        self._settle_dropped(entry, reason, self._now_us)

    def _settle_dropped(self, entry: Entry, reason: str, now_us: int) -> None:
        entry.settled = True
        if self._trace is not None:
            self._trace.dropped(now_us, entry, reason)
        self._emit(ev.Dropped(entry.outgoing, reason, entry.sent, now_us))

    # --------------------------------------------------------------------------------------------------------- endings

    def _on_breach(self, error: ProtocolError, now_us: int) -> None:
        if isinstance(error, VersionError):
            self.refuse(RefusalCode.VERSION, "version", str(error), now_us=now_us)
        else:
            unexpected = isinstance(error, UnexpectedMessageError)
            code = RefusalCode.UNEXPECTED if unexpected else RefusalCode.MALFORMED
            self.refuse(code, "", str(error), now_us=now_us)

    def _on_timeout(self, reason: str, now_us: int) -> None:
        self.refuse(RefusalCode.TIMEOUT, "", reason, now_us=now_us)

    def _on_close(self, now_us: int) -> None:
        self._now_us = now_us
        if self._trace is not None:
            self._trace.closed(now_us)
        self._queue.clear("closed")
        self._abandoned.clear()
        for flight in self._flow.drain():
            if not flight.entry.settled:
                self._settle_dropped(flight.entry, "closed", now_us)
        self._queue.on_drop = _unheard  # nothing is queued any more, and the session is no part of a cycle


def _unheard(entry: Entry, reason: str) -> None:
    """Ignore drops from a queue whose session is over."""
