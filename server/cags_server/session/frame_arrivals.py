"""Which frames' data a viewer had at their display, as the acknowledgements of frames' ends tell."""

from __future__ import annotations

from cags_server.records import StreamStats


class FrameArrivals:
    """Counts into ``stats``: frames in time, frames late, and stalls, runs of late ones.

    An acknowledgement takes the way up, and so do the poses that the client's clock is known by: the two delays cancel.
    """

    def __init__(self, stats: StreamStats) -> None:
        self._stats = stats
        self._displays: dict[int, int] = {}  # media frame whose end is on its way -> its display, client clock
        self._stalled = False

    def expect(self, frame: int, display_us: int) -> None:
        """The end of ``frame`` is sent; the viewer displays it at ``display_us`` of the client's clock."""
        self._displays[frame] = display_us

    def forget(self) -> None:
        """The viewer wants something else: what is on its way is displayed at other times, or not at all."""
        self._displays.clear()

    def arrived(self, frame: int, client_us: int) -> None:
        """The end of ``frame`` was there at ``client_us`` of the client's clock."""
        display_us = self._displays.pop(frame, None)
        if display_us is None:
            return
        late = client_us > display_us
        self._stats.frames_late += late
        self._stats.frames_in_time += not late
        self._stats.stalls += late and not self._stalled
        self._stalled = late
