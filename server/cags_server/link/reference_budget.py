"""How many reference pictures a link bears: they take a share of it, and where that is too little there are fewer.

References go before tiles, and each is useless unless it comes soon. On a link slower than their video they would fill
it, arrive late, and leave nothing for the tiles and the ends of frames.
"""

from __future__ import annotations

from cags_server.link.state import LinkState

BURST_S = 0.25
"""Seconds of the share that may be spent at once."""


REFERENCE_OVERHEAD_BYTES = 320
"""Approximate size of the headers of a reference, of its mark, and of the packets of both."""


class ReferenceBudget:
    """Account of one client's references: a share of the link comes in, what they weigh goes out. It may be in debt."""

    def __init__(self, link: LinkState, share: float) -> None:
        """``share`` of the link, 1 for all of it."""
        self._link, self._share = link, share
        self._bytes: float | None = None
        self._then_us = 0
        self._waiting: dict[int, int] = {}  # references queued and not sent: frame -> bytes

    def bears(self, now_us: int, spare_us: float) -> bool:
        """Whether another reference may go: it is paid for, and what goes before it, which is what is in flight and
        the references that wait, leaves it room to arrive within ``spare_us``, after which it is of no use.
        """
        rate = self._link.estimate_bps(now_us) * self._share / 8
        if self._bytes is None:
            self._bytes, self._then_us = rate * BURST_S, now_us
        income = rate * max(now_us - self._then_us, 0) / 1e6
        self._bytes, self._then_us = min(self._bytes + income, rate * BURST_S), max(now_us, self._then_us)
        paid = self._bytes > 0 or self._share >= 1
        before = self._link.newest.in_flight_bytes + sum(self._waiting.values())
        return paid and self._link.through_us(before, now_us) < spare_us

    def spent(self, frame: int, size_bytes: int) -> None:
        """The reference of ``frame``, of this size, was queued."""
        self._waiting[frame] = size_bytes
        if self._bytes is not None:
            self._bytes -= size_bytes

    def left(self, frame: int) -> None:
        """The reference of ``frame`` has left the queue: it was sent or dropped."""
        self._waiting.pop(frame, None)
