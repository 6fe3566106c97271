"""How many bytes the tiles of one frame may take: income of the link, less what waits, plus what was left over.

And no more than will arrive before the frame is displayed. Detail that comes a frame late is worth nothing where the
next frame replaces it, and a queue that is allowed to stand makes all of it late: every byte sent, none of it seen.
"""

from __future__ import annotations

from cags_protocol import events as ev
from cags_protocol.messages import ReferenceFrame, TileLayers
from cags_server.records import FrameRecord

MAX_SAVED_S, MIN_SAVED_BYTES = 0.25, 128 * 1024
"""Unused budget is saved for a base layer larger than one frame's budget; more than this would be a burst."""

SMOOTHING = 0.2
"""Weight of the newest frame in the means of what overtakes."""

MAX_BUDGET_TICKS = 4
"""A stretch of skipped frames earns at most the budget of so many."""


class _PerFrame:
    """Bytes of one kind that a frame brings: the mean of late, and this one's."""

    def __init__(self) -> None:
        self.mean_bytes, self.now_bytes = 0.0, 0

    def end(self) -> None:
        self.mean_bytes += SMOOTHING * (self.now_bytes - self.mean_bytes)
        self.now_bytes = 0


class ByteBudget:
    """Account of one client's bytes: planned, not settled yet, and saved."""

    def __init__(self, queue_ms: float) -> None:
        """``queue_ms``: delay that planned but undelivered data may cause."""
        self._queue_ms = queue_ms
        self._outstanding_bytes = 0
        self.undecoded_bytes = 0
        """What the client last said that it holds undecoded: to wait there is no better than to wait on the link."""
        self._saved_bytes = 0
        self._travelling: dict[int, int] = {}  # tiles queued and not settled: identity -> when, oldest first
        self._references, self._bases = _PerFrame(), _PerFrame()

    def planned(self, outgoing: ev.Outgoing, now_us: int) -> None:
        """A message was handed to the session."""
        self._outstanding_bytes += len(outgoing.payload)
        message = outgoing.message
        if isinstance(message, TileLayers):
            self._travelling[id(outgoing)] = now_us
            self._bases.now_bytes += len(outgoing.payload) if message.from_lod == 0 else 0
        elif isinstance(message, ReferenceFrame):
            self._references.now_bytes += len(outgoing.payload)

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
        waiting_bytes = self._outstanding_bytes + self.undecoded_bytes
        excess = max(0.0, waiting_bytes - allowed_bps * self._queue_ms / 8e3)
        income = int(allowed_bps * seconds / 8 - record.reference_bytes - excess)
        return max(0, income + self._saved_bytes)

    def room(self, spare_us: float, period_us: float, link_bps: float, dearest_bytes: int) -> int:
        """Bytes that will still arrive within ``spare_us`` behind all that is on its way over ``link_bps``.

        Never more than the allowed delay and a frame's ``period_us`` hold. Base layers and references of the frames
        that are planned meanwhile go ahead, as many as of late. Only references overtake a base layer: there is room
        for ``dearest_bytes``, the dearest new one's, if it arrives in time itself, or never could.
        """
        within_us = min(max(spare_us, 0.0), self._queue_ms * 1e3 + period_us)
        at_most = int(link_bps * within_us / 8e6)
        arriving = at_most - self._outstanding_bytes
        frames = max(within_us / period_us - 1, 0.0)  # that are planned meanwhile
        for_bases = arriving - int(frames * self._references.mean_bytes)
        fits = dearest_bytes <= for_bases or dearest_bytes > at_most
        return max(for_bases - int(frames * self._bases.mean_bytes), dearest_bytes * fits) if arriving > 0 else 0

    def close(self, left_bytes: int, allowed_bps: float) -> None:
        """The frame is planned; what it left is saved, up to a bound."""
        self._references.end()
        self._bases.end()
        most = max(allowed_bps * MAX_SAVED_S / 8, MIN_SAVED_BYTES)
        self._saved_bytes = min(max(0, left_bytes), int(most))
