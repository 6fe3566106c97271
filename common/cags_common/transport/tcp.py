"""The kernel's side of sending: how little may wait there, and what it knows of the path."""

from __future__ import annotations

import contextlib
import socket
import struct
from dataclasses import dataclass
from typing import Any

TCP_NOTSENT_LOWAT = getattr(socket, "TCP_NOTSENT_LOWAT", 25)
NOTSENT_BYTES = 16 * 1024
"""Unsent bytes in the kernel above which a socket is not writable: what is decided late stays decided late."""

WRITE_BUFFER_BYTES = 8 * 1024
"""Unsent bytes in the process above which a writer waits."""

_INFO = struct.Struct("=8B24I4Q6IQ")  # struct tcp_info of linux/tcp.h, up to tcpi_delivery_rate
_FLAGS, _RTT, _MIN_RTT, _DELIVERY_RATE = 7, 23, 39, 42


@dataclass(frozen=True)
class TcpInfo:
    """What Linux knows of a TCP connection."""

    rtt_us: int
    min_rtt_us: int
    delivery_rate_bps: float
    app_limited: bool


def tune_socket(sock: Any) -> None:
    """Keep queues in the kernel short and small writes immediate; systems without an option go without it."""
    for option, value in ((TCP_NOTSENT_LOWAT, NOTSENT_BYTES), (socket.TCP_NODELAY, 1)):
        with contextlib.suppress(OSError):
            sock.setsockopt(socket.IPPROTO_TCP, option, value)


def tcp_info(sock: Any) -> TcpInfo | None:
    """The kernel's figures for a connected TCP socket; None where there are none (not Linux, not TCP, closed)."""
    option = getattr(socket, "TCP_INFO", None)
    if option is None or sock is None:
        return None
    try:
        raw = sock.getsockopt(socket.IPPROTO_TCP, option, _INFO.size)
    except OSError:
        return None
    if len(raw) < _INFO.size:
        return None
    fields = _INFO.unpack(raw)
    return TcpInfo(
        rtt_us=fields[_RTT],
        min_rtt_us=fields[_MIN_RTT],
        delivery_rate_bps=fields[_DELIVERY_RATE] * 8.0,
        app_limited=bool(fields[_FLAGS] & 1),
    )
