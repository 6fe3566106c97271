"""How many reference pictures a link bears: they take a share of it, and where that is too little there are fewer.

References go before tiles, and each is useless unless it comes soon. On a link slower than their video they would fill
it, arrive late, and leave nothing for the tiles and the ends of frames.
"""

from __future__ import annotations

BURST_S = 0.25
"""Seconds of the share that may be spent at once."""


class ReferenceBudget:
    """Account of one client's references: a share of the link comes in, what they weigh goes out. It may be in debt."""

    def __init__(self, share: float) -> None:
        """``share`` of the link, 1 for all of it."""
        self._share = share
        self._bytes: float | None = None
        self._then_us = 0
        self.in_flight_bytes = 0
        """On the link when the newest acknowledgement came: what no priority overtakes."""

    def bears(self, now_us: int, link_bps: float, spare_us: float) -> bool:
        """Whether another reference may go, now that the link carries ``link_bps``: it is paid for, and what is in
        flight leaves it room to arrive within ``spare_us``, after which it is of no use.
        """
        rate = link_bps * self._share / 8
        if self._bytes is None:
            self._bytes, self._then_us = rate * BURST_S, now_us
        income = rate * max(now_us - self._then_us, 0) / 1e6
        self._bytes, self._then_us = min(self._bytes + income, rate * BURST_S), max(now_us, self._then_us)
        paid = self._bytes > 0 or self._share >= 1
        return paid and self.in_flight_bytes * 8e6 / link_bps < spare_us

    def spent(self, size_bytes: int) -> None:
        """A reference of this size was queued."""
        if self._bytes is not None:
            self._bytes -= size_bytes
