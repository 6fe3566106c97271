"""The states of both sessions, and which message leads where. A message without an entry breaks the protocol."""

from __future__ import annotations

import enum
from types import MappingProxyType

from cags_protocol.wire import messages as m


class State(enum.Enum):
    """Where a session stands."""

    GREETING = "greeting"  # server: waits for Hello; client: has not said Hello
    DECIDING = "deciding"  # server: Hello received, waits for accept or refuse; client: Hello sent, waits for Welcome
    OPEN = "open"
    CLOSED = "closed"


Table = MappingProxyType[tuple[State, type[m.Message]], State]

SERVER_TABLE: Table = MappingProxyType(
    {
        (State.GREETING, m.Hello): State.DECIDING,
        (State.GREETING, m.Bye): State.CLOSED,
        (State.DECIDING, m.Ping): State.DECIDING,
        (State.DECIDING, m.Bye): State.CLOSED,
        (State.OPEN, m.PoseBatch): State.OPEN,
        (State.OPEN, m.Ack): State.OPEN,
        (State.OPEN, m.Control): State.OPEN,
        (State.OPEN, m.KeyframeRequest): State.OPEN,
        (State.OPEN, m.Ping): State.OPEN,
        (State.OPEN, m.Pong): State.OPEN,
        (State.OPEN, m.Bye): State.CLOSED,
    }
)

CLIENT_TABLE: Table = MappingProxyType(
    {
        (State.GREETING, m.Refusal): State.CLOSED,
        (State.DECIDING, m.Welcome): State.OPEN,
        (State.DECIDING, m.Refusal): State.CLOSED,
        (State.DECIDING, m.Ping): State.DECIDING,
        (State.DECIDING, m.Pong): State.DECIDING,
        (State.DECIDING, m.Bye): State.CLOSED,
        (State.OPEN, m.Fragment): State.OPEN,
        (State.OPEN, m.Abandon): State.OPEN,
        (State.OPEN, m.Notice): State.OPEN,
        (State.OPEN, m.Ping): State.OPEN,
        (State.OPEN, m.Pong): State.OPEN,
        (State.OPEN, m.Refusal): State.CLOSED,
        (State.OPEN, m.Bye): State.CLOSED,
    }
)
