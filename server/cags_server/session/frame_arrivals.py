"""Counts the frames whose data the client had when they were due; acknowledgements of frame ends tell when it came.

A frame is counted once it was due by the client's own clock, as its poses tell it, and by the share of frames that it
says it displays. Whether it displayed it, or skipped it because it was still busy with the one before, is not known
here. What was sent ahead and never was due counts as nothing, and so do the pictures of a pause and what was due after
the last pose of a client that left without a goodbye.
"""

from __future__ import annotations

from collections.abc import Callable

from cags_protocol.cadence import next_displayed
from cags_protocol.timeline import Timeline
from cags_server.records import StreamStats
from cags_server.session.clock import ClientClock

MOST_AT_ONCE = 300
"""Ticks that may pass between two poses, a few seconds: a clock that tells of more has jumped, or its machine slept."""


class FrameArrivals:
    """Counts frames in time, late frames and stalls (runs of late frames) in ``stats``.

    The delay of an acknowledgement needs no correction, because poses have the same delay, and the client's clock is
    estimated from them. Arrivals are kept by the server's clock: the first may come before any pose.
    """

    def __init__(self, stats: StreamStats, clock: ClientClock, gof_start: Callable[[int], int]) -> None:
        """``gof_start``: the first frame of a media frame's group; clients keep no group that they have left."""
        self._stats, self._clock, self._gof_start = stats, clock, gof_start
        self._on_way = set[int]()  # media frames whose end was sent
        self._arrived: dict[int, int] = {}  # media frame -> when its end came, server clock
        self._next_tick = 0  # of the timeline since the last control: the first that was not displayed yet
        self._first_kept = 0  # media frame
        self._stalled = False

    def sent(self, frame: int) -> None:
        """The end of ``frame`` is queued."""
        self._on_way.add(frame)

    def arrived(self, frame: int, now_us: int) -> None:
        """The end of ``frame`` was acknowledged at ``now_us``, server clock. Of several, the first one counts."""
        if frame in self._on_way:
            self._on_way.discard(frame)
            self._arrived.setdefault(frame, now_us)

    def restart(self) -> None:
        """After a control ticks are counted anew; the client holds what it has."""
        self._next_tick = 0

    def forget(self) -> None:
        """The client discards all that it holds, and what is on its way."""
        self._on_way.clear()
        self._arrived.clear()

    def displayed(self, timeline: Timeline, until_us: int, permille: int) -> None:
        """All frames up to ``until_us`` of the client's clock were due; ``permille`` is its cadence."""
        if not timeline.playing:
            return
        end = timeline.first_tick(until_us + 1)
        if end - self._next_tick > MOST_AT_ONCE:
            self._next_tick = end
        last = None if timeline.loop else timeline.round_end(0) - 1
        for tick in range(self._next_tick, end if last is None else min(end, last + 1)):
            if tick == last or next_displayed(tick, permille) == tick:
                frame = timeline.media_frame(tick)
                assert frame is not None, "ticks past the end are not displayed"
                self._settle(frame, timeline.display_us(tick))
        self._next_tick = max(self._next_tick, end)

    def _settle(self, frame: int, display_us: int) -> None:
        self._keep_from(self._gof_start(frame))
        arrived_us = self._arrived.get(frame)
        late = arrived_us is None or arrived_us > self._clock.to_server(display_us)
        self._stats.frames_late += late
        self._stats.frames_in_time += not late
        self._stats.lately.append(late)
        self._stats.stalls += late and not self._stalled
        self._stalled = late

    def _keep_from(self, first: int) -> None:
        if first != self._first_kept:
            self._arrived = {frame: us for frame, us in self._arrived.items() if frame >= first}
        self._first_kept = first
