"""How many bytes the tiles of one frame may take: income of the link, less what waits, plus what was left over."""

from __future__ import annotations

from cags_protocol import events as ev
from cags_protocol.messages import TileLayers
from cags_server.records import FrameRecord

MAX_SAVED_S, MIN_SAVED_BYTES = 0.25, 128 * 1024
"""Unused budget is saved for a base layer larger than one frame's budget; more than this would be a burst."""

MAX_BUDGET_TICKS = 4
"""A stretch of skipped frames earns at most the budget of so many."""


class ByteBudget:
    """Account of one client's bytes: planned, not settled yet, and saved."""

    def __init__(self, queue_ms: float) -> None:
        """``queue_ms``: delay that planned but undelivered data may cause."""
        self._queue_ms = queue_ms
        self._outstanding_bytes = 0
        self._saved_bytes = 0
        self._travelling: dict[int, int] = {}  # tiles queued and not settled: identity -> when, oldest first

    def planned(self, outgoing: ev.Outgoing, now_us: int) -> None:
        """A message was handed to the session."""
        self._outstanding_bytes += len(outgoing.payload)
        if isinstance(outgoing.message, TileLayers):
            self._travelling[id(outgoing)] = now_us

    def settled(self, outgoing: ev.Outgoing) -> None:
        """A message was delivered or dropped."""
        self._outstanding_bytes -= len(outgoing.payload)
        self._travelling.pop(id(outgoing), None)

    def waiting_us(self, now_us: int) -> int:
        """How long the oldest unsettled tile has been on its way."""
        return now_us - next(iter(self._travelling.values()), now_us)

    def open(self, record: FrameRecord, allowed_bps: float, period_us: float) -> int:
        """What the tiles of ``record``'s frame may take; its reference is paid for first."""
        seconds = min(record.ticks_covered, MAX_BUDGET_TICKS) * period_us / 1e6
        excess = max(0.0, self._outstanding_bytes - allowed_bps * self._queue_ms / 8e3)
        income = int(allowed_bps * seconds / 8 - record.reference_bytes - excess)
        return max(0, income + self._saved_bytes)

    def close(self, left_bytes: int, allowed_bps: float) -> None:
        """The frame is planned; what it left is saved, up to a bound."""
        most = max(allowed_bps * MAX_SAVED_S / 8, MIN_SAVED_BYTES)
        self._saved_bytes = min(max(0, left_bytes), int(most))
