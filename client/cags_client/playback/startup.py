"""The startup buffer: how long the first frame is held, and refined, before the clip plays.

A clip that starts as soon as its base layers have arrived looks worst in its first second. The client therefore tells
the server that it is paused at the first frame, and the server refines it, until nothing more arrives or the longest
hold is over.
"""

from __future__ import annotations

QUIET_US = 250_000
"""The hold ends when no tile has arrived for this long, nor a part of one: over a slow link one may take longer."""

UNREFINED_QUIET_US = 1_000_000
"""The same from the codebooks on until the first tile after them: what waited behind them, as references planned
meanwhile, comes before the tiles.
"""

PREVIEW_EVERY_US = 200_000
"""While tiles arrive, the held frame is redrawn at this interval."""


class Startup:
    """Decides how long one play holds its first frame."""

    def __init__(self, most_us: int, now_us: int) -> None:
        """``most_us``: the longest hold."""
        self._most_us = most_us
        self._newest_us = self._drawn_us = now_us
        self._whole_us: int | None = None
        self._equipped_us, self._equipped, self._refined = now_us, True, True
        self.greeting = 0
        """References that had come when the hold began: drawn for a client with few splats or none, they would spoil
        what was refined since. They are forgotten when the clip plays.
        """

    def came(self, now_us: int, *, tile: bool = True, equipped: bool = True) -> None:
        """A ``tile`` has arrived, or codebooks, or a part of a message.

        ``equipped``: after the codebooks of all levels. Before, nothing can be refined, and the hold does not end.
        """
        self._refined = self._equipped and (tile or self._refined)
        if equipped and not self._equipped:
            self._equipped_us = now_us
        self._newest_us, self._equipped = now_us, equipped

    def whole(self, now_us: int) -> bool:
        """A frame is complete. Returns whether it is the first one, whose hold begins now."""
        if self._whole_us is not None:
            return False
        self._whole_us = now_us
        return True

    @property
    def ends_us(self) -> int | None:
        """When the hold ends if nothing more arrives; None before the first frame is complete and can be refined."""
        if self._whole_us is None or not self._equipped:
            return None
        begun_us = max(self._whole_us, self._equipped_us)
        quiet_us = QUIET_US if self._refined else UNREFINED_QUIET_US
        return min(begun_us + self._most_us, max(self._newest_us + quiet_us, self._whole_us))

    def preview(self, now_us: int) -> bool:
        """Whether to redraw the held frame now that more of it has arrived."""
        if now_us - self._drawn_us < PREVIEW_EVERY_US:
            return False
        self._drawn_us = now_us
        return True
