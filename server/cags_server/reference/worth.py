"""Whether references are worth the processor, where there is too little of it to make them in time.

What a reference brings is gone with its frame; what a tile brings stays, and costs the server next to nothing. On a
machine that is short, references are therefore left out while tiles alone will soon make the picture about as good as
it will be. Where that would take long, since the link carries too little of what changes, they are what there is to
see, however few of them there are.
"""

from __future__ import annotations

from cags_server.reference.lateness import Lateness

SOON_FRAMES, LONG_FRAMES = 40.0, 60.0
"""Tiles that are through within so many frames will do; from so many on they will not. Between the two all stays."""


class Worth:
    """Decides whether one client's references are worth making."""

    def __init__(self) -> None:
        self._tiles_will_do = False
        self._work = Lateness()

    def observe(self, coming_bytes: int, link_bps: float, period_us: float) -> None:
        """Tiles of ``coming_bytes`` are still to come over a link of ``link_bps``; a frame lasts ``period_us``."""
        frames = coming_bytes * 8e6 / (link_bps * period_us)
        if not SOON_FRAMES < frames < LONG_FRAMES:
            self._tiles_will_do = frames <= SOON_FRAMES

    def made(self, *, slowly: bool) -> None:
        """A reference was made, or would have been, ``slowly``: the next one was due before it."""
        self._work.observe(late=slowly)

    @property
    def short(self) -> bool:
        """Whether the machine often takes too long for references."""
        return self._work.often

    @property
    def pays(self) -> bool:
        """Whether references are to be made."""
        return not (self.short and self._tiles_will_do)
