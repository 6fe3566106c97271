"""Whether references pay, or what they take would make more of a client's picture as tiles.

What a reference brings is gone with its frame; what a tile brings stays. References take bytes that tiles lack, hold
back tiles that came after what they assume, and cost a render of the client's own splats. While tiles alone will soon
make the picture about as good as it will be, they go first. References pay where that would take long, since the link
carries too little of what changes, and where nothing is left to send.
"""

from __future__ import annotations

SOON_FRAMES = 0.0
"""Tiles that are through within so many frames go first."""

LONG_FRAMES = 60.0
"""From so many frames on references do not wait for them."""

IDLE_FRAMES = 3.0
"""Where so little is lacking, references take nothing from anybody."""

BUSY_FRAMES = 6.0
"""From so many frames on they do again."""


class Worth:
    """Of one client's references."""

    def __init__(self) -> None:
        self.pays = True
        """Whether references pay now."""

    def observe(self, lacking_bytes: int, link_bps: float, period_us: float) -> None:
        """Tiles of ``lacking_bytes`` are still to be sent over a link of ``link_bps``; a frame lasts ``period_us``."""
        frames = lacking_bytes * 8e6 / (link_bps * period_us)
        if SOON_FRAMES < frames < LONG_FRAMES or IDLE_FRAMES < frames < BUSY_FRAMES:
            return
        self.pays = not BUSY_FRAMES <= frames <= SOON_FRAMES
