"""What one device does with its time: the share of media frames it displays, their pixels, and the pictures between.

In this order of worth: every media frame, then all pixels, then pictures between the media frames, evenly, up to the
display's rate. One object decides all three, by one model of what a picture costs: a fixed part, and a part by its
pixels, measured on every picture that is drawn while the play goes on.

Steps down follow soon, steps up after a while in which there was room. Each step up that had to be taken back soon
doubles that while, so that a machine at the edge does not flicker between two looks.

A client that simply drops what comes too late draws whichever frame is due when it has done with the last one. The
server cannot know which that will be, so it looks at frames that nobody sees. A client that cannot keep up therefore
says what share it displays (:mod:`cags_protocol.cadence`): a little more than it manages, so that the machine sets the
pace.

The page has the same controller (``web/src/player/quality.ts``), pinned to this one by shared vectors.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf

from cags_client.settings import AUTO, FULL, HALF, OFF, ON
from cags_protocol.cadence import EVERY_FRAME, LEAST_PERMILLE, next_displayed

SCALES = {FULL: (1.0,), HALF: (0.5,), AUTO: (0.5, 1.0)}
"""Shares of the display's width that may be drawn, by the viewer's wish."""

SPLAT_SHARE = 0.2
"""Of what pixels cost at full resolution: what drawing costs however few they are (half takes 0.35 to 0.45 of full)."""

DOWN_AFTER_US = 250_000
UP_AFTER_US, UP_AFTER_MOST_US = 2_000_000, 32_000_000
"""How long a setting must take too long to be stepped down from, and how long there must be room for the next one: the
least, and the most. The very first steps up need no longer than steps down.
"""

SMOOTHING_US = 300_000
"""Time constant of the running means of what pictures cost."""

HITCH = 2.0
"""A picture counts for no more than so many times what was expected of it, or a period where that is more."""

UP_SHARE = 0.8
"""Of the period: what a setting may take, by what is known, to be stepped up to; all of it where a lower resolution
gains little.
"""

LEAST_GAIN, WORTH_GAIN = 0.95, 0.8
"""A lower level that takes more than the share ``LEAST_GAIN`` of the time of the present one is no help. Nor is a lower
resolution that takes more than ``WORTH_GAIN`` if few frames are too late, or if even the lowest is not in time: the
loss of pixels is visible, the few milliseconds are not.
"""

SLOW, HEADROOM = 0.85, 1.05
"""Fewer frames are displayed where less than the share ``SLOW`` of them can be; then as many as can be, and a little
more: drawing never waits for the next one for long.
"""

MOST_FALL, STEADY = 0.5, 0.06
"""The share of frames falls by no more than the factor ``MOST_FALL`` at once, and changes by no less than ``STEADY``
of itself: while it changes, references are of other frames than are displayed.
"""

LEAST_PICTURES, EVEN_PICTURES = 1.25, 1.9
"""Pictures a period, the media frame included: the fewest that a display shows more than media frames with; and, where
it could show more, the fewest that are spread evenly (about two).
"""

CAUTION = 1.25
"""The time that a picture between two frames is taken to need, in those that the last ones took."""


class Quality:
    """Chooses what a device draws. Times in microseconds; costs are of its own clock."""

    def __init__(self, scales: Sequence[float], display_us: float, *, skips: bool = True) -> None:
        """``scales``: shares of the display's width that may be drawn, rising. ``skips``: whether media frames may be
        left out. There are no pictures between them until they are wished for.
        """
        self.period_us = self.display_us = display_us
        """From one media frame to the next, and from one refresh of the display to the next."""
        self.permille = EVERY_FRAME
        """How many of 1,000 media frames are displayed."""
        self._scales, self._skips, self._between = tuple(scales), skips, OFF
        self._fixed_us, self._fixed_between_us, self._pixels_us = 0.0, 0.0, 0.0  # pixels: at full resolution
        self._last_us: int | None = None
        self._seen_between = False
        self._over_since_us: int | None = None
        self._room_since_us: int | None = None
        self._stepped_up_us: int | None = None
        self._patience_us = DOWN_AFTER_US
        self._level = len(self._scales) - 1
        """Place among the scales, and after them among the densities of pictures between frames."""

    # ------------------------------------------------------------------------------------------------------ decisions

    @property
    def scale(self) -> float:
        """Share of the display's width that is drawn."""
        return self._scale_of(self._level)

    @property
    def step_us(self) -> float | None:
        """From one picture to the next between media frames; None: there are none."""
        if self._between == ON:
            return self.display_us if self._most_between else None
        return self._step_of(self._level)

    def fits(self, now_us: int, due_us: float) -> bool:
        """Whether a picture between frames, begun now, is done before the media frame due at ``due_us``."""
        return self._between == ON or now_us + CAUTION * self._between_us(self.scale) <= due_us

    # ------------------------------------------------------------------------------------------------------ knowledge

    def wish(self, scales: Sequence[float], between: str) -> None:
        """What may be chosen among: ``scales``, and OFF, ON or AUTO for pictures between media frames.

        Where that changes, nothing of what was decided stays; all that was measured does.
        """
        if (tuple(scales), between) != (self._scales, self._between):
            self._scales, self._between = tuple(scales), between
            self._level, self._patience_us = len(self._scales) - 1, DOWN_AFTER_US
            self.permille, self._stepped_up_us = EVERY_FRAME, None
            self.restart()

    def restart(self) -> None:
        """The play goes on elsewhere or otherwise: the while that was under way counts for nothing."""
        self._over_since_us = self._room_since_us = None

    def observe(self, now_us: int, took_us: float, pixels_us: float, *, media: bool = True) -> None:
        """A picture was done at ``now_us``; ``pixels_us`` of what it took went into its pixels.

        ``media``: it was a media frame in its turn, and not one between two.
        """
        self._learn(now_us, took_us, pixels_us, media=media)
        if self._level >= len(self._scales) + self._most_between:  # the display is slower than it was
            self._level = len(self._scales) - 1 + self._most_between
        if self._over:
            self._room_since_us = None
            self._over_since_us = now_us if self._over_since_us is None else self._over_since_us
            if now_us - self._over_since_us >= DOWN_AFTER_US:
                self._step_down(now_us)
            return
        self._over_since_us = None
        if not self._room:
            self._room_since_us = None
            return
        self._room_since_us = now_us if self._room_since_us is None else self._room_since_us
        if now_us - self._room_since_us >= self._patience_us:
            self._step_up(now_us)

    def _learn(self, now_us: int, took_us: float, pixels_us: float, *, media: bool) -> None:
        passed = SMOOTHING_US if self._last_us is None else max(now_us - self._last_us, 0)
        self._last_us = now_us
        expected = self._media_us(self.scale) if media else self._between_us(self.scale)
        counts = min(max(HITCH * expected, self.period_us) / took_us, 1.0) if took_us > 0 else 1.0
        pixels = min(pixels_us, took_us) * counts
        fixed = took_us * counts - pixels
        weight = passed / (passed + SMOOTHING_US)
        self._pixels_us += weight * (pixels / _relative(self.scale) - self._pixels_us)
        if media:
            self._fixed_us += weight * (fixed - self._fixed_us)
        else:
            self._fixed_between_us += (weight if self._seen_between else 1.0) * (fixed - self._fixed_between_us)
            self._seen_between = True

    # ---------------------------------------------------------------------------------------------------------- levels

    @property
    def _most_between(self) -> int:
        """Levels of pictures between frames: each next one has twice as many, the last one as many as the display."""
        levels, step_us, least = 0, self.display_us, LEAST_PICTURES
        while self._between != OFF and least * step_us <= self.period_us:
            levels, step_us, least = levels + 1, 2 * step_us, EVEN_PICTURES
        return levels

    def _scale_of(self, level: int) -> float:
        return self._scales[min(level, len(self._scales) - 1)]

    def _step_of(self, level: int) -> float | None:
        beyond, most = level - (len(self._scales) - 1), self._most_between
        return self.display_us * 2.0 ** (most - beyond) if 0 < beyond <= most else None

    def _media_us(self, scale: float) -> float:
        return self._fixed_us + self._pixels_us * _relative(scale)

    def _between_us(self, scale: float) -> float:
        fixed_us = self._fixed_between_us if self._seen_between else self._fixed_us
        return fixed_us + self._pixels_us * _relative(scale)

    def _takes_us(self, level: int) -> float:
        """What the pictures of one period take at a level."""
        scale = self._scale_of(level)
        step_us = self.step_us if self._between == ON else self._step_of(level)
        more = 0.0 if step_us is None else (self.period_us / step_us - 1.0) * self._between_us(scale)
        return self._media_us(scale) + more

    @property
    def _lower(self) -> bool:
        """Whether there is a lower level that helps."""
        takes_us = self._takes_us(self._level)
        if self._level == 0 or self._takes_us(self._level - 1) > LEAST_GAIN * takes_us:
            return False
        if self._level >= len(self._scales):
            return True
        least_us, slow = self._takes_us(0), SLOW * takes_us > self.period_us
        return least_us <= WORTH_GAIN * takes_us or (slow and least_us <= self.period_us)

    @property
    def _top(self) -> int:
        return len(self._scales) - 1 + (self._most_between if self._between == AUTO else 0)

    @property
    def _over(self) -> bool:
        """Whether what is drawn takes too long, and something can be done about it."""
        takes_us = self._takes_us(self._level)
        if self._lower:
            return takes_us > self.period_us
        if self.permille == EVERY_FRAME:
            return self._skips and SLOW * takes_us > self.period_us
        return self.permille > LEAST_PERMILLE and self._affordable < (1.0 - STEADY) * self.permille

    @property
    def _room(self) -> bool:
        """Whether there is time for the next level up."""
        if self.permille < EVERY_FRAME:
            wanted = self._possible
            return wanted == EVERY_FRAME or wanted > (1.0 + STEADY) * self.permille
        if self._level >= self._top:
            return False
        takes_us = self._takes_us(self._level + 1)
        gains = self._level + 1 >= len(self._scales) or self._takes_us(0) <= WORTH_GAIN * takes_us
        return takes_us <= (UP_SHARE if gains else 1.0) * self.period_us

    @property
    def _affordable(self) -> float:
        """How many pictures there is time for while 1,000 media frames are due: of any size."""
        takes_us = self._takes_us(self._level)
        return HEADROOM * EVERY_FRAME * self.period_us / takes_us if takes_us > 0 else inf

    @property
    def _possible(self) -> int:
        """How many of 1,000 media frames to display, by what they take."""
        return max(int(min(self._affordable, EVERY_FRAME)), LEAST_PERMILLE)

    # ----------------------------------------------------------------------------------------------------------- steps

    def _step_down(self, now_us: int) -> None:
        hasty = self._stepped_up_us is not None and now_us - self._stepped_up_us < 2 * self._patience_us
        self._patience_us = min(max(2 * self._patience_us, UP_AFTER_US), UP_AFTER_MOST_US) if hasty else UP_AFTER_US
        if self._lower:
            self._level -= 1
        else:
            self.permille = max(self._possible, int(self.permille * MOST_FALL), LEAST_PERMILLE)
        self._stepped_up_us = None
        self.restart()

    def _step_up(self, now_us: int) -> None:
        if self.permille < EVERY_FRAME:
            self.permille = self._possible
        else:
            self._level += 1
        self._stepped_up_us = now_us
        self.restart()


def next_due(tick: int, end_tick: int, permille: int) -> int:
    """The first tick to display from ``tick`` on; that before ``end_tick`` is displayed in any case."""
    return min(next_displayed(tick, permille), end_tick - 1)


def newest_due(tick: int, end_tick: int, permille: int, is_due: Callable[[int], bool]) -> int:
    """The newest tick due of those to display from ``tick`` on, which is one of them."""
    while (later := next_due(tick + 1, end_tick, permille)) > tick and is_due(later):
        tick = later
    return tick


def _relative(scale: float) -> float:
    """What pixels cost at ``scale``, full resolution being 1."""
    return SPLAT_SHARE + (1.0 - SPLAT_SHARE) * scale * scale
