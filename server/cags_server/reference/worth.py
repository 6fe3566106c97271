"""Whether references are worth the processor, where there is too little of it to make them in time.

What a reference brings is gone with its frame; what a tile brings stays, and costs the server next to nothing. On a
machine that is short, references are therefore left out while tiles alone will soon make the picture about as good as
it will be. Where that would take long, since the link carries too little of what changes, they are what there is to
see, however few of them there are.
"""

from __future__ import annotations

SOON_FRAMES, LONG_FRAMES = 40.0, 60.0
"""Tiles that are through within so many frames will do; from so many on they will not. Between the two all stays."""


class Worth:
    """Of one client's references."""

    def __init__(self) -> None:
        self._tiles_will_do = False

    def observe(self, coming_bytes: int, link_bps: float, period_us: float) -> None:
        """Tiles of ``coming_bytes`` are still to come over a link of ``link_bps``; a frame lasts ``period_us``."""
        frames = coming_bytes * 8e6 / (link_bps * period_us)
        if not SOON_FRAMES < frames < LONG_FRAMES:
            self._tiles_will_do = frames <= SOON_FRAMES

    def pays(self, *, short: bool) -> bool:
        """Whether references are made on a machine that is ``short`` of time for them, or is not."""
        return not (short and self._tiles_will_do)
