"""How many of the media frames a client displays: all of them, or as many as this machine can draw, evenly spread.

A client that simply drops what comes too late draws whichever frame is due when it has done with the last one. The
server cannot know which that will be, so it looks at frames that nobody sees, and what is seen has the reference of an
earlier frame, which costs a second own view. Where a client cannot keep up it therefore says what share it displays
(:mod:`cags_protocol.cadence`): a little more than it manages, so that it is the machine that sets the pace.
"""

from __future__ import annotations

from collections.abc import Callable

from cags_protocol.cadence import EVERY_FRAME, LEAST_PERMILLE, next_displayed

WINDOW_US = 1_000_000
"""Time over which drawn frames are counted before the share is chosen anew."""

LEAST_COUNTED = 8
"""A window with fewer frames to draw says nothing: the clip stood still, or was slow."""

SLOW = 0.85
"""A client that draws all frames begins to choose among them where it managed less than this share of a window."""

MET, MISSED = 0.97, 0.88
"""Managed shares of the chosen frames above which more are chosen, and below which fewer."""

RAISE, HEADROOM = 1.08, 1.03
"""More by this factor; fewer: as many as were managed, and so much more."""


class Cadence:
    """Of one play."""

    def __init__(self, first_frame: int) -> None:
        self.permille = EVERY_FRAME
        """How many of 1,000 media frames are displayed."""
        self.counted_from = first_frame
        """The media frame that the newest Control named; each loop since takes a clip's frames off it."""
        self._since_us: int | None = None
        self._due = self._chosen = self._drawn = 0

    def next(self, frame: int, end_frame: int) -> int:
        """The first media frame to display from ``frame`` on; that before ``end_frame`` is displayed in any case."""
        return min(self.counted_from + next_displayed(frame - self.counted_from, self.permille), end_frame - 1)

    def newest_due(self, now_us: int, from_frame: int, end_frame: int, due_us: Callable[[int], int]) -> int:
        """The frame to draw now: the newest one due of those to display from ``from_frame`` on."""
        frame, missed = self.next(from_frame, end_frame), 0
        while (later := self.next(frame + 1, end_frame)) > frame and due_us(later) <= now_us:
            frame, missed = later, missed + 1
        self._count(now_us, frame + 1 - from_frame, missed)
        return frame

    def restart(self, frame: int) -> None:
        """A Control names ``frame``: the window that was under way counts for nothing."""
        self.counted_from, self._since_us = frame, None

    def _count(self, now_us: int, due: int, missed: int) -> None:
        """A frame begins to be drawn, ``due`` media frames after the one before; ``missed`` chosen ones are late."""
        if self._since_us is None:
            self._since_us, self._due, self._chosen, self._drawn = now_us, 0, 0, 0
            return
        self._due += due
        self._drawn += 1
        self._chosen += 1 + missed
        if now_us - self._since_us >= WINDOW_US:
            if self._chosen >= LEAST_COUNTED:
                self._choose(self._drawn / self._chosen, self._drawn / self._due)
            self._since_us, self._due, self._chosen, self._drawn = now_us, 0, 0, 0

    def _choose(self, managed: float, of_all: float) -> None:
        """``managed``: share of the chosen frames that was drawn; ``of_all``: of all media frames."""
        share = self.permille / EVERY_FRAME
        if self.permille < EVERY_FRAME and managed >= MET:
            share *= RAISE
        elif managed < (MISSED if self.permille < EVERY_FRAME else SLOW):
            share = of_all * HEADROOM
        self.permille = min(max(round(share * EVERY_FRAME), LEAST_PERMILLE), EVERY_FRAME)
