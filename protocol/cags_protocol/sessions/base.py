"""What both sessions share: the state machine, the event queue, small messages that go at once, and timers.

Sans-IO: nothing here knows a socket, a clock or a task. The owner passes ``now_us`` (its own monotonic clock), writes
what ``data_to_send`` returns, and calls ``handle_timer`` when ``next_timer_us`` is reached.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Generic, TypeVar

from cags_common.errors import ProtocolError
from cags_protocol.events import Closed
from cags_protocol.sessions.states import State, Table
from cags_protocol.wire.encoding import decode, encode
from cags_protocol.wire.messages import Buffer, Bye, Message, Ping, Pong

E = TypeVar("E")


@dataclass(frozen=True)
class SessionTimers:
    """Times after which a session acts by itself, microseconds."""

    handshake_us: int = 10_000_000
    """A peer that has not finished the handshake by then is dropped."""
    keepalive_us: int = 5_000_000
    """A session that has sent nothing for this long sends a ping."""
    idle_us: int = 15_000_000
    """A session that has heard nothing for this long is over."""


class Session(Generic[E]):
    """Base of :class:`ServerSession` and :class:`ClientSession`."""

    def __init__(self, table: Table, timers: SessionTimers, *, now_us: int) -> None:
        self._table, self._timers = table, timers
        self._state = State.GREETING
        self._events: deque[E | Closed] = deque()
        self._urgent: deque[bytes] = deque()
        self._started_us = self._heard_us = self._said_us = now_us

    @property
    def state(self) -> State:
        """Where the session stands."""
        return self._state

    @property
    def closed(self) -> bool:
        """Whether the session is over. What ``data_to_send`` still returns should be written before hanging up."""
        return self._state is State.CLOSED

    def next_event(self) -> E | Closed | None:
        """The next event, oldest first; None when there is none."""
        return self._events.popleft() if self._events else None

    def receive(self, data: Buffer, *, now_us: int) -> None:
        """Take one message of the peer. Never raises for what a peer sends: a breach ends the session with an event."""
        if self.closed:
            return
        try:
            message, payload = decode(data)
            self._heard_us = now_us
            self._step(message, payload, now_us)
        except ProtocolError as error:
            self._on_breach(error, now_us)

    def connection_lost(self, reason: str, *, now_us: int) -> None:
        """The transport ended without a Bye."""
        self._close("lost", reason, now_us)

    def next_timer_us(self) -> int | None:
        """When ``handle_timer`` wants to be called; None when never."""
        if self.closed:
            return None
        if self._state is not State.OPEN:
            return self._started_us + self._timers.handshake_us
        return min(self._heard_us + self._timers.idle_us, self._said_us + self._timers.keepalive_us)

    def handle_timer(self, *, now_us: int) -> None:
        """Do what is due at ``now_us``."""
        if self.closed:
            return
        if self._state is not State.OPEN:
            if now_us >= self._started_us + self._timers.handshake_us:
                self._on_timeout(f"no handshake within {self._timers.handshake_us / 1e6:g} s", now_us)
        elif now_us >= self._heard_us + self._timers.idle_us:
            self._on_timeout(f"nothing heard for {self._timers.idle_us / 1e6:g} s", now_us)
        elif now_us >= self._said_us + self._timers.keepalive_us:
            self._say(Ping(now_us), now_us)

    def bye(self, reason: str = "", *, now_us: int) -> None:
        """Leave; the Bye is in ``data_to_send``."""
        if not self.closed:
            self._say(Bye(reason), now_us)
            self._close("bye", reason, now_us)

    # ------------------------------------------------------------------------------------------------- for subclasses

    def _step(self, message: Message, payload: memoryview, now_us: int) -> None:
        state = self._table.get((self._state, type(message)))
        if state is None:
            raise UnexpectedMessageError(f"{message.TAG} must not come in state {self._state.value}")
        if isinstance(message, Ping):
            self._say(Pong(message.t_us), now_us)
        elif isinstance(message, Bye):
            self._close("bye", message.reason, now_us)
        elif not isinstance(message, Pong):
            self._state = State.OPEN if state is State.CLOSED else state  # _on_message closes, with its own event
            self._on_message(message, payload, now_us)

    def _on_message(self, message: Message, payload: memoryview, now_us: int) -> None:
        raise NotImplementedError

    def _on_breach(self, error: ProtocolError, now_us: int) -> None:
        raise NotImplementedError

    def _on_timeout(self, reason: str, now_us: int) -> None:
        self.bye(reason, now_us=now_us)

    def _on_close(self, now_us: int) -> None:
        """Let go of what the session holds."""

    def _say(self, message: Message, now_us: int) -> None:
        """Send a small message before all data."""
        self._urgent.append(encode(message))
        self._said_us = now_us

    def _emit(self, event: E) -> None:
        self._events.append(event)

    def _close(self, code: str, reason: str, now_us: int) -> None:
        if self.closed:
            return
        self._on_close(now_us)
        self._state = State.CLOSED
        self._events.append(Closed(code, reason))


class UnexpectedMessageError(ProtocolError):
    """A message that the state of the session does not allow."""
