"""The client's clock, read on the server.

The client's clock is the session's; it is behind the server's by an unknown offset. Every message that carries a client
time arrives a network delay later, so the smallest (arrival - time) of the recent ones is the offset plus the shortest
delay: it errs by that delay alone, to the safe side (frames are planned that much later, never before their pose).
"""

from __future__ import annotations

from collections import deque

WINDOW_US = 10_000_000

JUMP_US, JUMP_LASTS_US = 5_000_000, 1_000_000
"""A clock that reads so much less than it should, for so long, was set back, or has slept: no network is so slow."""


class ClientClock:
    """Estimates server time minus client time."""

    def __init__(self) -> None:
        self._offsets: deque[tuple[int, int]] = deque()  # (arrival, offset), rising offset: the front is the smallest
        self._guess_us = 0
        self._behind_since_us: int | None = None  # since when every message was later than a network makes it

    def guess(self, client_us: int, arrival_us: int) -> None:
        """Around ``arrival_us`` the client's clock may have read ``client_us``; believed until more is known."""
        self._guess_us = arrival_us - client_us

    def observe(self, client_us: int, arrival_us: int) -> None:
        """A message written at ``client_us`` of the client's clock came in at ``arrival_us`` of the server's."""
        offset = arrival_us - client_us
        if self._has_jumped(offset, arrival_us):
            self._offsets.clear()
        while self._offsets and self._offsets[-1][1] >= offset:
            self._offsets.pop()
        self._offsets.append((arrival_us, offset))
        while self._offsets[0][0] < arrival_us - WINDOW_US:
            self._offsets.popleft()

    def _has_jumped(self, offset: int, arrival_us: int) -> bool:
        if not self._offsets or offset <= self._offsets[0][1] + JUMP_US:
            self._behind_since_us = None
            return False
        if self._behind_since_us is None:
            self._behind_since_us = arrival_us
        return arrival_us - self._behind_since_us >= JUMP_LASTS_US

    @property
    def offset_us(self) -> int:
        """Server time minus client time."""
        return self._offsets[0][1] if self._offsets else self._guess_us

    def to_client(self, server_us: int) -> int:
        """A time of the server's clock as the client's."""
        return server_us - self.offset_us

    def to_server(self, client_us: int) -> int:
        """A time of the client's clock as the server's."""
        return client_us + self.offset_us
