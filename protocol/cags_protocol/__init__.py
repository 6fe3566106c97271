"""The wire protocol: messages, their strict encoding, and the two sans-IO sessions. See ``docs/wire.md``."""

from cags_protocol.client import ClientSession, ClientSessionSettings
from cags_protocol.encoding import decode, encode
from cags_protocol.events import AckSample, Outgoing
from cags_protocol.limits import PROTOCOL_VERSION, SUBPROTOCOL
from cags_protocol.messages import Message
from cags_protocol.server import ServerSession, ServerSessionSettings
from cags_protocol.session import SessionTimers
from cags_protocol.states import State

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
