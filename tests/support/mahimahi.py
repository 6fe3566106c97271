"""mahimahi's link, written out as its source does it: the oracle for ours."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any

PACKET_SIZE = 1504


class MahimahiQueue:
    """mahimahi's LinkQueue::rationalize, with a drop-tail queue: one opportunity at a time."""

    def __init__(
        self, times_ms: Sequence[int], queue_bytes: int | None = None, queue_packets: int | None = None
    ) -> None:
        self.schedule, self.base, self.next = times_ms, 0, 0
        self.queue_bytes, self.queue_packets = queue_bytes, queue_packets
        self.waiting: deque[tuple[Any, int]] = deque()
        self.transit: Any = None
        self.left = 0
        self.out: list[tuple[int, Any]] = []

    def next_ms(self) -> int:
        """Time of the next opportunity."""
        return self.schedule[self.next] + self.base

    def rationalize(self, now_ms: int) -> None:
        """Use up the opportunities until now."""
        while self.next_ms() <= now_ms:
            time, budget = self.next_ms(), PACKET_SIZE
            self.next = (self.next + 1) % len(self.schedule)
            if self.next == 0:
                self.base += self.schedule[-1]
            while budget > 0:
                if not self.left:
                    if not self.waiting:
                        break
                    self.transit, self.left = self.waiting.popleft()
                used = min(budget, self.left)
                budget, self.left = budget - used, self.left - used
                if not self.left:
                    self.out.append((time, self.transit))

    def push(self, now_ms: int, name: Any, size: int) -> bool:
        """Queue a packet."""
        self.rationalize(now_ms)
        full = self.queue_bytes is not None and sum(s for _, s in self.waiting) + size > self.queue_bytes
        if full or (self.queue_packets is not None and len(self.waiting) + 1 > self.queue_packets):
            return False
        self.waiting.append((name, size))
        return True
