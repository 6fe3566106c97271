"""The transport seam: whole messages, in order, between two peers."""

from __future__ import annotations

from typing import Protocol

from cags_common.errors import NetworkError


class ConnectionEndedError(NetworkError):
    """The connection is over: the peer closed it, or it broke."""


class Transport(Protocol):
    """One connection that carries binary messages."""

    @property
    def peer(self) -> str:
        """Address of the other end, for logs and limits."""
        ...

    async def send(self, data: bytes) -> None:
        """Write one message; returns when little of it is left unwritten. Raises :class:`ConnectionEndedError`.

        Cancelling takes nothing back.
        """

    async def recv(self) -> bytes:
        """The next message. Raises :class:`ConnectionEndedError` once there are no more."""

    async def close(self, reason: str = "") -> None:
        """End the connection; does not raise, and may be called again."""

    def abort(self) -> None:
        """End the connection at once; what was not written yet is lost. May be called again."""
