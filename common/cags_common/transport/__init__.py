"""Transports: whole messages between two peers, over WebSockets or in memory."""

from cags_common.transport.base import ConnectionEndedError, Transport
from cags_common.transport.memory import MemoryTransport, memory_pair

__all__ = ["ConnectionEndedError", "MemoryTransport", "Transport", "memory_pair"]
