"""How far tiles go ahead of their frame: further over a link with capacity to spare, as a reserve for worse times.

Where all that the client sees is sent, the link would be idle, so the tiles and the end of one more frame go at once.
When the link falls, what moves goes on moving until the reserve is used up, and what was sent ahead need not be sent
then. Over a link that always has detail to carry there is no reserve: bought with detail, it brought nothing in the
mean of 18 plays over links that fall.
"""

from __future__ import annotations

from cags_server.ratecontrol.outlook import Supply


class Reserve:
    """The number of displayed frames by which tiles precede the reference of their frame."""

    def __init__(self, least: int, longest_s: float) -> None:
        """``least`` frames; more as long as they are displayed within ``longest_s`` seconds."""
        self.least, self._longest_us = least, longest_s * 1e6
        """The fewest frames."""
        self.frames = least

    @property
    def grown(self) -> bool:
        """Whether it is more than the least."""
        return self.frames > self.least

    def covers(self, ahead_us: float) -> bool:
        """Whether tiles may precede their frame by so much."""
        return ahead_us <= self._longest_us

    def planned(self, supply: Supply, *, period_us: float) -> None:
        """A frame was planned; displayed frames are ``period_us`` apart."""
        if supply is Supply.BASE_MISSING:
            self.hold()
        elif supply is Supply.COMPLETE:
            self.reach_on(period_us)

    def reach_on(self, period_us: float) -> None:
        """One frame more, if it is displayed soon enough; displayed frames are ``period_us`` apart."""
        if (self.frames + 1) * period_us <= self._longest_us:
            self.frames += 1

    def hold(self, frames: int = 1) -> None:
        """Plan tiles for the same frame again while its display comes ``frames`` closer; not closer than the least."""
        self.frames = max(self.frames - frames, self.least)

    def restart(self) -> None:
        """The viewer jumped, or stopped: what lies ahead is not what was sent."""
        self.frames = self.least
