"""How many bytes the tiles of one frame may take: income of the link, less what waits, plus what was left over.

And no more than will arrive before the frame is displayed. Detail that comes a frame late is worth nothing where the
next frame replaces it, and a queue that is allowed to stand makes all of it late: every byte sent, none of it seen.
"""

from __future__ import annotations

from math import ceil

from cags_protocol import events as ev
from cags_protocol.wire.messages import ReferenceFrame, TileLayers
from cags_server.link.state import LinkState
from cags_server.ratecontrol.priorities import BASE_PRIORITY
from cags_server.records import FrameRecord

MAX_SAVED_S, MIN_SAVED_BYTES = 0.25, 128 * 1024
"""Unused budget is saved for a base layer larger than one frame's budget; more than this would be a burst."""

MESSAGE_OVERHEAD_BYTES = 160
"""Header of a tile message and its fragment, about."""

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

    def __init__(self, link: LinkState, queue_ms: float) -> None:
        """``queue_ms``: delay that planned but undelivered data may cause."""
        self._link, self._queue_ms = link, queue_ms
        self._outstanding_bytes = self._detail_bytes = 0
        self._saved_bytes = 0
        self._travelling: dict[int, int] = {}  # tiles queued and not settled: identity -> when, oldest first
        self._references = _PerFrame()

    def planned(self, outgoing: ev.Outgoing, now_us: int) -> None:
        """A message was handed to the session."""
        self._outstanding_bytes += _size(outgoing)
        message = outgoing.message
        if isinstance(message, TileLayers):
            self._travelling[id(outgoing)] = now_us
            self._detail_bytes += _size(outgoing) if outgoing.priority > BASE_PRIORITY else 0
        elif isinstance(message, ReferenceFrame):
            self._references.now_bytes += _size(outgoing)

    def settled(self, outgoing: ev.Outgoing) -> None:
        """A message was delivered or dropped."""
        self._outstanding_bytes -= _size(outgoing)
        if self._travelling.pop(id(outgoing), None) is not None and outgoing.priority > BASE_PRIORITY:
            self._detail_bytes -= _size(outgoing)

    def waiting_us(self, now_us: int) -> int:
        """How long the oldest unsettled tile has been on its way."""
        return now_us - next(iter(self._travelling.values()), now_us)

    @property
    def outstanding_bytes(self) -> int:
        """Planned, and not known to have arrived."""
        return self._outstanding_bytes

    def open(self, record: FrameRecord, period_us: float, now_us: int) -> int:
        """What the tiles of ``record``'s frame may take; its reference is paid for first.

        To wait at the client for its decoder is no better than to wait on the link.
        """
        allowed_bps = self._link.allowance_bps(now_us)
        seconds = min(record.ticks_covered, MAX_BUDGET_TICKS) * period_us / 1e6
        waiting_bytes = self._outstanding_bytes + self._link.newest.undecoded_bytes
        excess = max(0.0, waiting_bytes - allowed_bps * self._queue_ms / 8e3)
        income = int(allowed_bps * seconds / 8 - record.reference_bytes - excess)
        return max(0, income + self._saved_bytes)

    def room(self, period_us: float, now_us: int) -> int:
        """What may be planned until as much waits as the link carries in the allowed delay and one frame's time."""
        link_bps = self._link.estimate_bps(now_us)
        return max(int(self._delay_bytes(link_bps, period_us) - self._waiting_bytes(link_bps)), 0)

    def timely(self, spare_us: float, period_us: float, dearest_bytes: int, now_us: int) -> int:
        """What still arrives, planned ``spare_us`` before its display, if it overtakes the detail that waits.

        The references of the frames that are planned meanwhile overtake it, as large as they were of late. A new tile
        may be too large ever to arrive in time behind those: there is room for ``dearest_bytes``, the largest one's,
        when what waits is no more than would pass by the display. Late it is shown, too, until the next comes.
        """
        link_bps, newest = self._link.estimate_bps(now_us), self._link.newest
        within_us = max(spare_us - newest.shortest_rtt_us, 0.0)
        delay_bytes = self._delay_bytes(link_bps, period_us)
        most = min(_carried(within_us, period_us, link_bps, self._references.mean_bytes), delay_bytes)
        overtaken = max(self._detail_bytes - newest.in_flight_bytes, 0)
        ahead = max(self._waiting_bytes(link_bps) - overtaken, 0.0)
        room = max(int(most - ahead), 0)
        late = dearest_bytes > most and ahead < min(link_bps * within_us / 8e6, delay_bytes)
        return max(room, dearest_bytes) if late else room

    def _delay_bytes(self, link_bps: float, period_us: float) -> float:
        return link_bps * (self._queue_ms * 1e3 + period_us) / 8e6

    def _waiting_bytes(self, link_bps: float) -> float:
        """All that is on its way, less what has passed the link: that is on the path, as far as that holds it."""
        newest = self._link.newest
        return max(self._outstanding_bytes - min(newest.in_flight_bytes, link_bps * newest.shortest_rtt_us / 8e6), 0.0)

    def close(self, left_bytes: int, now_us: int) -> None:
        """The frame is planned; what it left is saved, up to a bound."""
        self._references.end()
        most = max(self._link.allowance_bps(now_us) * MAX_SAVED_S / 8, MIN_SAVED_BYTES)
        self._saved_bytes = min(max(0, left_bytes), int(most))


def _size(outgoing: ev.Outgoing) -> int:
    return len(outgoing.payload) + MESSAGE_OVERHEAD_BYTES


def _carried(within_us: float, period_us: float, link_bps: float, ahead_bytes: float) -> float:
    """The most that is through a link ``within_us`` from now if every ``period_us`` so much goes ahead of it.

    What is through when the last of them comes does not wait for it; and where they are more than the link carries,
    what is through when the first comes is all there will be.
    """
    frames = max(ceil(within_us / period_us) - 1, 0)  # that are planned meanwhile
    by_the_end = link_bps * within_us / 8e6 - frames * ahead_bytes
    before_the_first = link_bps * period_us / 8e6
    before_the_last = frames * before_the_first - (frames - 1) * ahead_bytes
    return max(by_the_end, before_the_first, before_the_last) if frames else by_the_end
