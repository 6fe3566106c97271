"""The wire protocol: messages, their strict encoding, and the two sans-IO sessions. See ``docs/wire.md``."""

from cags_protocol.events import AckSample, Outgoing
from cags_protocol.sessions.base import SessionTimers
from cags_protocol.sessions.client import ClientSession, ClientSessionSettings
from cags_protocol.sessions.server import ServerSession, ServerSessionSettings
from cags_protocol.sessions.states import State
from cags_protocol.wire.encoding import decode, encode
from cags_protocol.wire.limits import PROTOCOL_VERSION, SUBPROTOCOL
from cags_protocol.wire.messages import Message

__all__ = [
    "PROTOCOL_VERSION",
    "SUBPROTOCOL",
    "AckSample",
    "ClientSession",
    "ClientSessionSettings",
    "Message",
    "Outgoing",
    "ServerSession",
    "ServerSessionSettings",
    "SessionTimers",
    "State",
    "decode",
    "encode",
]
