"""How many of the media frames a client displays: all of them, or as many as this machine can draw, evenly spread.

A client that simply drops what comes too late draws whichever frame is due when it has done with the last one. The
server cannot know which that will be, so it looks at frames that nobody sees, and what is seen has the reference of an
earlier frame, which costs a second render from the reference camera. Where a client cannot keep up it therefore says
what share it displays (:mod:`cags_protocol.cadence`): a little more than it manages, so that the machine sets the pace.
"""

from __future__ import annotations

from collections.abc import Callable

from cags_protocol.cadence import EVERY_FRAME, LEAST_PERMILLE, next_displayed

WINDOW_US = 1_000_000
"""Time over which drawn frames are counted before the share is chosen anew."""

LEAST_DRAWN = 4
"""A window is longer while it has fewer frames than these."""

SLOW = 0.85
"""A client that draws all frames begins to choose among them where it managed less than this share of a window."""

HEADROOM = 1.05
"""More frames are chosen than were possible, by this factor: drawing never waits for the next one for long."""

MOST_FALL = 0.5
"""A share falls by no more than this factor at once: a long hitch, as at the beginning, says little of what follows."""

STEADY = 0.06
"""A share that would change by less stays: while it changes, references are of other frames than are displayed."""


class Cadence:
    """Chooses which media frames one play displays: ticks of its :class:`~cags_protocol.timeline.Timeline`."""

    def __init__(self) -> None:
        self.permille = EVERY_FRAME
        """How many of 1,000 media frames are displayed."""
        self._since_us: int | None = None
        self._begun_us = 0  # the drawing of the newest frame
        self._busy_us = self._due = self._chosen = self._drawn = 0  # in this window

    def next(self, tick: int, end_tick: int) -> int:
        """The first tick to display from ``tick`` on; that before ``end_tick`` is displayed in any case."""
        return min(next_displayed(tick, self.permille), end_tick - 1)

    def newest_due(self, now_us: int, from_tick: int, end_tick: int, display_us: Callable[[int], int]) -> int:
        """The tick to draw now: the newest one due of those to display from ``from_tick`` on."""
        tick, missed = self.next(from_tick, end_tick), 0
        while (later := self.next(tick + 1, end_tick)) > tick and display_us(later) <= now_us:
            tick, missed = later, missed + 1
        if self._since_us is None:
            self._begin(now_us)
        self._begun_us = now_us
        self._due += tick + 1 - from_tick
        self._chosen += 1 + missed
        return tick

    def drawn(self, now_us: int) -> None:
        """The frame that was handed out is drawn."""
        if self._since_us is None:  # a Control came meanwhile
            return
        self._busy_us += now_us - self._begun_us
        self._drawn += 1
        if now_us - self._since_us >= WINDOW_US and self._drawn >= LEAST_DRAWN:
            self._choose(now_us - self._since_us)
            self._begin(now_us)

    def restart(self) -> None:
        """Ticks are counted anew: the window that was under way counts for nothing."""
        self._since_us = None

    def _begin(self, now_us: int) -> None:
        self._since_us, self._busy_us, self._due, self._chosen, self._drawn = now_us, 0, 0, 0, 0

    def _choose(self, window_us: int) -> None:
        """As many as were drawn, or would have been in the time in which nothing was."""
        if self.permille == EVERY_FRAME and self._drawn >= SLOW * self._chosen:
            return
        possible = self._drawn / self._due * window_us / max(self._busy_us, 1)
        wanted = max(round(possible * HEADROOM * EVERY_FRAME), round(self.permille * MOST_FALL), LEAST_PERMILLE)
        wanted = min(wanted, EVERY_FRAME)
        if wanted == EVERY_FRAME or abs(wanted - self.permille) > STEADY * self.permille:
            self.permille = wanted
