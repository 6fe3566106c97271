"""How much a client may send: token buckets over its messages, bytes and poses."""

from __future__ import annotations

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
    bytes: float = 4e6
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
