"""Counts the frames whose data arrived before their display, from the acknowledgements of frame ends."""

from __future__ import annotations

from cags_server.records import StreamStats


class FrameArrivals:
    """Counts frames in time, late frames and stalls (runs of late frames) in ``stats``.

    The delay of an acknowledgement needs no correction, because poses have the same delay, and the client's clock is
    estimated from them.
    """

    def __init__(self, stats: StreamStats) -> None:
        self._stats = stats
        self._displays: dict[int, int] = {}  # media frame whose end is on its way -> its display, client clock
        self._stalled = False

    def expect(self, frame: int, display_us: int) -> None:
        """The end of ``frame`` is sent; the viewer displays it at ``display_us`` of the client's clock."""
        self._displays[frame] = display_us

    def forget(self) -> None:
        """After a control: frames on their way are displayed at other times, or not at all."""
        self._displays.clear()

    def arrived(self, frame: int, client_us: int) -> None:
        """The end of ``frame`` arrived at ``client_us`` of the client's clock."""
        display_us = self._displays.pop(frame, None)
        if display_us is None:
            return
        late = client_us > display_us
        self._stats.frames_late += late
        self._stats.frames_in_time += not late
        self._stats.stalls += late and not self._stalled
        self._stalled = late
