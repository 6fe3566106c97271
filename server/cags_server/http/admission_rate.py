"""How fast strangers are taken on: beginning a session costs the server milliseconds, and asking for one costs nothing.

Under a flood the newest is served first. Whoever has waited for long is mostly there to wait, and one who comes in the
meantime is served at once.
"""

from __future__ import annotations

import asyncio

MAX_WAITING = 512
"""Beyond it the oldest is turned away."""


class AdmissionRate:
    """Lets ``rate`` a second through, and ``burst`` of them at once."""

    def __init__(self, rate: float = 30.0, burst: float = 40.0) -> None:
        self._rate, self._burst = rate, burst
        self._room, self._at_s = burst, float("-inf")
        self._waiting: list[asyncio.Future[bool]] = []
        self._timer: asyncio.TimerHandle | None = None

    async def take(self) -> bool:
        """Wait for a turn; False for one that has waited longest while too many wait."""
        loop = asyncio.get_running_loop()
        self._refill(loop.time())
        if not self._waiting and self._room >= 1:
            self._room -= 1
            return True
        turn: asyncio.Future[bool] = loop.create_future()
        self._waiting.append(turn)
        if len(self._waiting) > MAX_WAITING:
            _settle(self._waiting.pop(0), False)
        self._schedule(loop)
        try:
            return await turn
        finally:
            if turn in self._waiting:
                self._waiting.remove(turn)

    def _refill(self, now_s: float) -> None:
        self._room = min(self._room + (now_s - self._at_s) * self._rate, self._burst)
        self._at_s = now_s

    def _schedule(self, loop: asyncio.AbstractEventLoop) -> None:
        if self._timer is None and self._waiting:
            self._timer = loop.call_later(max((1 - self._room) / self._rate, 0.0), self._next, loop)

    def _next(self, loop: asyncio.AbstractEventLoop) -> None:
        self._timer = None
        self._refill(loop.time())
        while self._waiting and self._room >= 1:
            if _settle(self._waiting.pop(), True):
                self._room -= 1
        self._schedule(loop)


def _settle(turn: asyncio.Future[bool], answer: bool) -> bool:
    """Whether somebody still waits for it."""
    if turn.done():
        return False
    turn.set_result(answer)
    return True
