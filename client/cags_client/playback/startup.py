"""How long the first frame is held, while more of it comes, before the clip plays.

A clip that plays as soon as its coarsest layers are there is at its worst where it is looked at first. The first frame
is therefore held for a moment, and the server, which is told that the viewer pauses, refines it: until nothing more
comes, or as long as a viewer is made to wait.
"""

from __future__ import annotations

QUIET_US = 250_000
"""When nothing has come for so long, there is nothing more to come."""

PREVIEW_EVERY_US = 200_000
"""What is held is drawn anew so often, while more of it comes."""


class Startup:
    """Of one play."""

    def __init__(self, most_us: int, now_us: int) -> None:
        """The first frame is held for ``most_us`` at most."""
        self._most_us = most_us
        self._newest_us = self._drawn_us = now_us
        self._whole_us: int | None = None

    def came(self, now_us: int) -> None:
        """A tile has come."""
        self._newest_us = now_us

    def whole(self, now_us: int) -> bool:
        """A frame is there whole; True when that is the first one, which is held from now on."""
        first, self._whole_us = self._whole_us is None, now_us if self._whole_us is None else self._whole_us
        return first

    @property
    def ends_us(self) -> int | None:
        """When the clip is to play, if nothing more comes; None before its first frame is there."""
        if self._whole_us is None:
            return None
        return min(self._whole_us + self._most_us, max(self._newest_us + QUIET_US, self._whole_us))

    def preview(self, now_us: int) -> bool:
        """Whether what is held is to be drawn anew, since more of it has come."""
        if now_us - self._drawn_us < PREVIEW_EVERY_US:
            return False
        self._drawn_us = now_us
        return True
