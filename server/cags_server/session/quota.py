"""How much a client may send: token buckets over its messages, bytes and poses, and over the work that they cause."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


class TokenBucket:
    """Lets ``rate`` units a second through on average, ``burst`` of them at once."""

    def __init__(self, rate: float, burst: float, now_us: int) -> None:
        self._rate, self._burst = rate, burst
        self._tokens, self._filled_us = burst, now_us

    def take(self, units: float, now_us: int) -> bool:
        """Whether ``units`` may pass now."""
        elapsed_s = max(0, now_us - self._filled_us) / 1e6
        self._tokens = min(self._burst, self._tokens + elapsed_s * self._rate)
        self._filled_us = now_us
        if units > self._tokens:
            return False
        self._tokens -= units
        return True


@dataclass(frozen=True)
class Quotas:
    """Limits of one client, a second; bursts of ``BURST_S`` seconds are allowed."""

    messages: float = 1000.0
    bytes: float = 1e6
    poses: float = 2000.0


BURST_S = 2.0


class ClientQuota:
    """One client's use of its limits."""

    def __init__(self, quotas: Quotas, now_us: int) -> None:
        self._messages = TokenBucket(quotas.messages, quotas.messages * BURST_S, now_us)
        self._bytes = TokenBucket(quotas.bytes, quotas.bytes * BURST_S, now_us)
        self._poses = TokenBucket(quotas.poses, quotas.poses * BURST_S, now_us)

    def message(self, size: int, now_us: int) -> str | None:
        """Count a message in; the name of the limit it breaks, if any."""
        if not self._messages.take(1, now_us):
            return "messages"
        return None if self._bytes.take(size, now_us) else "bytes"

    def poses(self, count: int, now_us: int) -> str | None:
        """Count poses in; the name of the limit they break, if any."""
        return None if self._poses.take(count, now_us) else "poses"


READING_SHARE = 0.4
"""Share of the event loop's time that reading what clients say may take, over all of them."""

LEAST_SHARE = 0.02
"""What one of very many may take of it in any case."""

MESSAGE_S = 100e-6
"""What a message costs beside being read: it wakes whoever plans and sends for that client."""

SAVED_S = 0.1
"""Time that a client that said little may have saved up."""

LONGEST_PAUSE_S = 1.0


class ReadingShare:
    """One client's share of the time that the event loop has for reading. Times are seconds.

    Who takes more is not refused: it is read later, and TCP holds it back. That counts what a message costs, however
    much is packed into it.
    """

    def __init__(self, clients: Callable[[], int], now_s: float) -> None:
        """``clients()``: how many share the loop."""
        self._clients = clients
        self._saved_s, self._at_s = SAVED_S, now_s

    def took(self, seconds: float, now_s: float) -> float:
        """Reading a message took ``seconds`` of processor time; how long to wait before the next one is read."""
        share = max(READING_SHARE / max(self._clients(), 1), LEAST_SHARE)
        self._saved_s = min(self._saved_s + (now_s - self._at_s) * share, SAVED_S) - seconds - MESSAGE_S
        self._at_s = now_s
        return min(max(-self._saved_s / share, 0.0), LONGEST_PAUSE_S)
