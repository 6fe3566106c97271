"""Ends of frames that wait in the queue: which of them would be late, and whether the client shows an older frame.

Behind tiles and references ends would fall back ever further on a slow link, and the client shows nothing beyond them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from cags_protocol import events as ev
from cags_protocol.wire.messages import FrameEnd


class WaitingEnds:
    """The ends that were queued for one client and not sent. Times are the client's clock."""

    def __init__(self) -> None:
        self._displays: dict[int, int] = {}  # media frame -> its display
        self._taken_back: list[tuple[ev.Outgoing, int]] = []  # and their display

    def queued(self, outgoing: Iterable[ev.Outgoing], display_us: int) -> None:
        """Of ``outgoing`` the ends are of frames displayed at ``display_us``, or skipped before."""
        frames = [each.message.frame for each in outgoing if isinstance(each.message, FrameEnd)]
        self._displays |= dict.fromkeys(frames, display_us)

    def left(self, frame: int) -> int | None:
        """The end of ``frame`` left the queue; returns the display of the frame, None where the end was not known."""
        return self._displays.pop(frame, None)

    def clear(self) -> None:
        """After a control frames are displayed at other times, or not at all."""
        self._displays.clear()
        self._taken_back.clear()

    def has(self, frame: int, until_us: int) -> bool:
        """Whether the end of ``frame``, displayed until ``until_us``, waits."""
        display_us = self._displays.get(frame)
        return display_us is not None and display_us <= until_us

    def any_until(self, until_us: int) -> bool:
        """Whether the end of a frame that is displayed until ``until_us`` waits."""
        return any(display_us <= until_us for display_us in self._displays.values())

    def taken_back(self, end: ev.Outgoing, display_us: int) -> None:
        """``end`` was cancelled because it would be late."""
        self._taken_back.append((end, display_us))

    def again(self) -> list[ev.Outgoing]:
        """What was taken back, to queue again ahead of all else.

        The newest one covers all of them; the others are needed only if they name removed splats.
        """
        late, self._taken_back = self._taken_back, []
        kept = [(end, display_us) for end, display_us in late if end.payload or end is late[-1][0]]
        for end, display_us in kept:
            self.queued([end], display_us)
        return [replace(end, urgent=True) for end, _ in kept]
