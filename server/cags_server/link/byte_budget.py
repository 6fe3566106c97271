"""Byte budget for the tiles of one frame: the link's income, minus queued data, plus savings.

It is limited by what arrives before the frame's display. Detail that is one frame late is worthless if the next frame
replaces it, and with a standing queue all detail is late: every byte is sent and none of it seen.
"""

from __future__ import annotations

from math import ceil

from cags_protocol import events as ev
from cags_protocol.wire.messages import ReferenceFrame, TileLayers
from cags_server.link.state import LinkState
from cags_server.ratecontrol.priorities import BASE_PRIORITY
from cags_server.records import FrameRecord

MAX_SAVED_S, MIN_SAVED_BYTES = 0.25, 128 * 1024
"""Largest savings of unused budget, for base layers larger than one frame's budget; more would be a burst."""

MESSAGE_OVERHEAD_BYTES = 105
"""Approximate size of the headers of a tile message and its fragment."""

SMOOTHING = 0.2
"""Weight of the newest frame in the means of overtaking data."""

IDLE_FRAMES = 0.5
"""A link is idle if less data waits than it carries in this many frames; ends of frames and references always wait."""

MAX_BUDGET_TICKS = 4
"""Largest number of skipped frames that earn budget."""


class _PerFrame:
    """Bytes of one kind per frame: the recent mean, and those of the current frame."""

    def __init__(self) -> None:
        self.mean_bytes, self.now_bytes = 0.0, 0

    def end(self) -> None:
        self.mean_bytes += SMOOTHING * (self.now_bytes - self.mean_bytes)
        self.now_bytes = 0


class ByteBudget:
    """Account of one client's bytes: planned, unsettled and saved."""

    def __init__(self, link: LinkState, queue_ms: float) -> None:
        """``queue_ms``: largest delay by planned but undelivered data."""
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
        """Age of the oldest unsettled tile."""
        return now_us - next(iter(self._travelling.values()), now_us)

    @property
    def outstanding_bytes(self) -> int:
        """Planned bytes that are not known to have arrived."""
        return self._outstanding_bytes

    def open(self, record: FrameRecord, period_us: float, now_us: int) -> int:
        """Budget for the tiles of ``record``'s frame, after paying for its reference.

        Data waiting for the client's decoder counts like data waiting on the link.
        """
        allowed_bps = self._link.allowance_bps(now_us)
        seconds = min(record.ticks_covered, MAX_BUDGET_TICKS) * period_us / 1e6
        waiting_bytes = self._outstanding_bytes + self._link.newest.undecoded_bytes
        excess = max(0.0, waiting_bytes - allowed_bps * self._queue_ms / 8e3)
        income = int(allowed_bps * seconds / 8 - record.reference_bytes - excess)
        return max(0, income + self._saved_bytes)

    def room(self, period_us: float, now_us: int) -> int:
        """Bytes to fill the queue up to what the link carries in the allowed delay plus one frame's time."""
        link_bps = self._link.estimate_bps(now_us)
        return max(int(self._delay_bytes(link_bps, period_us) - self._waiting_bytes(link_bps)), 0)

    def timely(self, spare_us: float, period_us: float, dearest_bytes: int, now_us: int) -> int:
        """Bytes that arrive in time when planned ``spare_us`` before display, if they overtake waiting detail.

        References of later frames, at their recent size, overtake them in turn. A new tile may be too large ever to
        arrive in time behind these references. Therefore the budget allows ``dearest_bytes``, the size of the largest
        one, if no more data waits than passes by the display; a late tile is shown, too, until the next one arrives.
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

    def alone(self, earned_bytes: int, period_us: float, now_us: int) -> int:
        """Budget for one message without a deadline that exceeds the room: all savings, if no more data waits than the
        link carries in a share of a frame's time.
        """
        link_bps = self._link.estimate_bps(now_us)
        idle = self._waiting_bytes(link_bps) < IDLE_FRAMES * link_bps * period_us / 8e6
        return earned_bytes if idle else 0

    def _delay_bytes(self, link_bps: float, period_us: float) -> float:
        return link_bps * (self._queue_ms * 1e3 + period_us) / 8e6

    def _waiting_bytes(self, link_bps: float) -> float:
        """Data in flight, minus data that has passed the link and is on the path."""
        newest = self._link.newest
        return max(self._outstanding_bytes - min(newest.in_flight_bytes, link_bps * newest.shortest_rtt_us / 8e6), 0.0)

    def close(self, left_bytes: int, now_us: int) -> None:
        """Tiles have been chosen, which may happen several times a frame; the unused budget is saved, up to a limit."""
        most = max(self._link.allowance_bps(now_us) * MAX_SAVED_S / 8, MIN_SAVED_BYTES)
        self._saved_bytes = min(max(0, left_bytes), int(most))

    def end_frame(self) -> None:
        """The frame is planned: references from now on count towards the next one."""
        self._references.end()


def _size(outgoing: ev.Outgoing) -> int:
    return len(outgoing.payload) + MESSAGE_OVERHEAD_BYTES


def _carried(within_us: float, period_us: float, link_bps: float, ahead_bytes: float) -> float:
    """Largest amount that passes a link within ``within_us`` if ``ahead_bytes`` overtake it every ``period_us``.

    Data that has passed before the last overtaking message does not wait for it. If the overtaking data exceeds the
    link's rate, only what passes before the first message counts.
    """
    frames = max(ceil(within_us / period_us) - 1, 0)  # messages planned meanwhile
    by_the_end = link_bps * within_us / 8e6 - frames * ahead_bytes
    before_the_first = link_bps * period_us / 8e6
    before_the_last = frames * before_the_first - (frames - 1) * ahead_bytes
    return max(by_the_end, before_the_first, before_the_last) if frames else by_the_end
