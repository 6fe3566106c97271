"""Accepting connections without being brought down by too many of them.

``asyncio.start_server`` goes on accepting where there are no descriptors left, and logs a traceback for each attempt:
a hundred thousand lines a second. It also has no bound on connections that are open.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import socket
from collections.abc import Callable

from cags_common.runtime.rare_log import RareLog

PAUSE_S = 0.1
"""Rest after the system has run out of something that a connection needs."""

_EXHAUSTED = frozenset({errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM})
_THEIRS = frozenset({errno.ECONNABORTED, errno.EPROTO, errno.EPERM, errno.EINTR})
"""A connection that ended before it was taken, or that a firewall refuses."""


async def accept_all(
    listener: socket.socket, take: Callable[[socket.socket], None], log: logging.Logger, *, relieve: Callable[[], None]
) -> None:
    """Give each accepted socket, non-blocking, to ``take``, until cancelled.

    Where the system has none left, ``relieve`` is asked to end one, and a line is logged every ten seconds. Raises
    ``OSError`` for a listener that cannot be used any more.
    """
    loop, told = asyncio.get_running_loop(), RareLog(log, 10.0)
    while True:
        try:
            accepted, _ = await loop.sock_accept(listener)
        except OSError as error:
            if error.errno in _EXHAUSTED:
                told.write(logging.WARNING, "full", "no more connections can be accepted (%s)", error.strerror)
                relieve()
                await asyncio.sleep(PAUSE_S)
            elif error.errno not in _THEIRS:
                raise
        else:
            take(accepted)


def listen_on(host: str, port: int, backlog: int) -> list[socket.socket]:
    """Listening sockets for every address of ``host``, on one port (0: a free one). Raises ``OSError``."""
    found = socket.getaddrinfo(host or None, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    listeners: list[socket.socket] = []
    try:
        for family, kind, protocol, _, address in dict.fromkeys(found):
            if listeners and port == 0:
                address = (address[0], listeners[0].getsockname()[1], *address[2:])  # noqa: PLW2901
            listeners.append(_listening(socket.socket(family, kind, protocol), address, backlog))
    except OSError:
        for listener in listeners:
            listener.close()
        raise
    return listeners


def _listening(listener: socket.socket, address: tuple[object, ...], backlog: int) -> socket.socket:
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if listener.family == socket.AF_INET6:
            listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        listener.bind(address)
        listener.setblocking(False)
        listener.listen(backlog)
    except OSError:
        listener.close()
        raise
    return listener
