"""Accounts of the messages for one client, from queueing until they have arrived or never will."""

from __future__ import annotations

from cags_protocol import events as ev
from cags_protocol.wire.messages import FrameEnd, ReferenceFrame, TileLayers
from cags_server.link.byte_budget import ByteBudget
from cags_server.records import StreamStats
from cags_server.session.frame_arrivals import FrameArrivals
from cags_server.session.waiting_ends import WaitingEnds


class Dispatch:
    """Counts every message: in the byte budget when it is queued, in the totals when it has been sent; and ends of
    frames by themselves.
    """

    def __init__(self, budget: ByteBudget, arrivals: FrameArrivals, stats: StreamStats) -> None:
        self.budget, self.arrivals = budget, arrivals
        self.ends = WaitingEnds()
        self._stats = stats

    def queue(self, outgoing: list[ev.Outgoing], now_us: int) -> list[ev.Outgoing]:
        """The same messages, counted."""
        for each in outgoing:
            self.budget.planned(each, now_us)
            if isinstance(each.message, FrameEnd):
                self.arrivals.sent(each.message.frame)
        return outgoing

    def queue_frame(self, outgoing: list[ev.Outgoing], display_us: int, now_us: int) -> list[ev.Outgoing]:
        """The same messages, counted; the ends among them are of frames displayed at ``display_us`` (client clock), or
        skipped before.
        """
        self.ends.queued(outgoing, display_us)
        return self.queue(outgoing, now_us)

    def queue_again(self, now_us: int) -> list[ev.Outgoing]:
        """Ends of frames that were taken back because they would be late, ahead of all else."""
        return self.queue(self.ends.again(), now_us)

    def sent(self, outgoing: ev.Outgoing) -> None:
        """A message was sent to its end: what is cancelled or stale before that, and queued again, does not count."""
        size = len(outgoing.payload)
        if isinstance(outgoing.message, TileLayers):
            self._stats.bytes_tiles += size
        elif isinstance(outgoing.message, ReferenceFrame):
            self._stats.bytes_reference += size
        else:
            self._stats.bytes_other += size
