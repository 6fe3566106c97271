"""Whether references are worth the processor, where there is too little of it to make them in time.

What a reference brings is gone with its frame; what a tile brings stays, and costs the server next to nothing. On a
machine that is short, references are therefore left out while tiles alone will soon make the picture about as good as
it will be. Where that would take long, since the link carries too little of what changes, they are what there is to
see, however few of them there are; but only if they come in time. Those that are too late take processor time from the
tiles: after several in a row none is made for a while, and for longer each time that the next one is late as well.
"""

from __future__ import annotations

from cags_server.reference.lateness import Lateness

SOON_FRAMES, LONG_FRAMES = 40.0, 60.0
"""Tiles that are through within so many frames will do; from so many on they will not. Between the two all stays."""

IN_VAIN = 3
"""After so many references in a row that were of no use, none is made for a while."""

REST_US, LONGEST_REST_US = 2_000_000, 16_000_000
"""The shortest and the longest such pause."""


class Worth:
    """Decides whether one client's references are worth making."""

    def __init__(self) -> None:
        self._tiles_will_do = False
        self._work = Lateness()
        self._in_vain, self._rest_us, self._rests_until_us, self._now_us = 0, REST_US, 0, 0

    def observe(self, coming_bytes: int, link_bps: float, period_us: float, now_us: int) -> None:
        """Tiles of ``coming_bytes`` are still to come over a link of ``link_bps``; a frame lasts ``period_us``."""
        self._now_us = now_us
        frames = coming_bytes * 8e6 / (link_bps * period_us)
        if not SOON_FRAMES < frames < LONG_FRAMES:
            self._tiles_will_do = frames <= SOON_FRAMES

    def made(self, *, slowly: bool) -> None:
        """A reference was made, or would have been, ``slowly``: the next one was due before it."""
        self._work.observe(late=slowly)

    def came(self, now_us: int, *, in_vain: bool) -> None:
        """A reference was sent, or given up; ``in_vain``: it took long, and comes after the display of its frame."""
        self._now_us = now_us
        if not in_vain:
            self._in_vain, self._rest_us = 0, REST_US
            return
        self._in_vain += 1
        if self._in_vain >= IN_VAIN:
            self._rests_until_us = now_us + self._rest_us
            self._rest_us = min(2 * self._rest_us, LONGEST_REST_US)

    @property
    def short(self) -> bool:
        """Whether the machine often takes too long for references."""
        return self._work.often

    @property
    def pays(self) -> bool:
        """Whether references are to be made."""
        return self._now_us >= self._rests_until_us and not (self.short and self._tiles_will_do)
