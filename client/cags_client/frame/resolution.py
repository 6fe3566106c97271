"""How many pixels a frame is drawn and corrected at: the display's own, or half of them a side.

At half everything up to the shown picture is worked out on a quarter of the pixels, through a footprint of its own, and
only that picture is brought up. With ``auto`` the client decides while it plays, by :class:`TierController`: down as
soon as frames take too long for a while, up again after a longer one. Each step up that had to be taken back doubles
that while, so that a machine at the edge does not flicker between two looks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from cags_client.settings import AUTO, FULL, HALF

PIXEL_STAGES = ("raster", "correct", "align", "restore", "enlarge")
"""Stages whose time is one of pixels."""

SHARES = {HALF: 4.0, FULL: 10.0}
"""What these stages take together, one resolution against the other (measured: 0.35 to 0.45), in units of the load."""


DOWN_SHARE = 1.0
"""Of the frame time: frames that take longer are late, and the tier is stepped down."""

UP_SHARE = 0.8
"""Of the frame time: what a frame with the dearer tier may take, by what is known, to step up."""

DOWN_AFTER_S = 0.25
UP_AFTER_S = 2.0
UP_AFTER_MOST_S = 32.0
SMOOTHING_S = 0.3
"""Time constant of the running means of what frames take."""

SHORTEST_MS = 0.5
"""Tiers that take less say nothing about the machine's load."""

FORGETTING = 0.1
"""How much slower than others' means the load is forgotten."""


@dataclass(frozen=True)
class Tier:
    """A way to draw by name, and the milliseconds that one picture takes by it."""

    name: str
    cost_ms: float


@dataclass(eq=False)
class TierController:
    """Chooses among ``tiers``, cheapest first, for frames of ``frame_ms``."""

    tiers: Sequence[Tier]
    frame_ms: float
    rest_ms: float = 0.0
    """What a frame takes beside its pixels, as far as it is known."""
    _place: int = field(default=-1, init=False)
    _load: float = field(default=1.0, init=False)
    """What tiers take now over what they took when they were measured."""
    _last_s: float | None = field(default=None, init=False)
    _over_since_s: float | None = field(default=None, init=False)
    _room_since_s: float | None = field(default=None, init=False)
    _stepped_up_s: float | None = field(default=None, init=False)
    _patience_s: float = field(default=UP_AFTER_S, init=False)

    def __post_init__(self) -> None:
        if not self.tiers:
            raise ValueError("there is nothing to choose from")
        self._place = self._dearest_that_fits()

    @property
    def name(self) -> str:
        """The tier in use."""
        return self.tiers[self._place].name

    def observe(self, now_s: float, pixels_ms: float | None, frame_ms: float) -> str:
        """A frame was shown at ``now_s``; it took ``frame_ms``, ``pixels_ms`` of it for its pixels (None: nothing).

        Returns the tier for the next frame.
        """
        share = self._share(now_s)
        self.rest_ms += share * (frame_ms - (pixels_ms or 0.0) - self.rest_ms)
        usual_ms = self.tiers[self._place].cost_ms
        if pixels_ms is None or usual_ms < SHORTEST_MS:  # nothing is known of the load: it is forgotten, slowly
            self._load += share * FORGETTING * (1.0 - self._load)
        else:
            self._load += share * (pixels_ms / usual_ms - self._load)
        if self._over(now_s):
            self._step_down(now_s)
        elif self._room(now_s):
            self._step_up(now_s)
        return self.name

    def _share(self, now_s: float) -> float:
        passed = SMOOTHING_S if self._last_s is None else max(now_s - self._last_s, 0.0)
        self._last_s = now_s
        return 1.0 - float(np.exp(-passed / SMOOTHING_S))

    def _takes(self, place: int) -> float:
        return self.rest_ms + self.tiers[place].cost_ms * self._load

    def _dearest_that_fits(self) -> int:
        fitting = [i for i in range(len(self.tiers)) if self._takes(i) <= UP_SHARE * self.frame_ms]
        return max(fitting, default=0)

    def _over(self, now_s: float) -> bool:
        if self._place == 0 or self._takes(self._place) <= DOWN_SHARE * self.frame_ms:
            self._over_since_s = None
            return False
        self._over_since_s = now_s if self._over_since_s is None else self._over_since_s
        return now_s - self._over_since_s >= DOWN_AFTER_S

    def _room(self, now_s: float) -> bool:
        above = self._place + 1
        if above >= len(self.tiers) or self._takes(above) > UP_SHARE * self.frame_ms:
            self._room_since_s = None
            return False
        self._room_since_s = now_s if self._room_since_s is None else self._room_since_s
        return now_s - self._room_since_s >= self._patience_s

    def _step_down(self, now_s: float) -> None:
        hasty = self._stepped_up_s is not None and now_s - self._stepped_up_s < 2 * self._patience_s
        self._patience_s = min(2 * self._patience_s, UP_AFTER_MOST_S) if hasty else UP_AFTER_S
        self._place -= 1
        self._over_since_s = self._room_since_s = self._stepped_up_s = None

    def _step_up(self, now_s: float) -> None:
        self._place += 1
        self._over_since_s = self._room_since_s = None
        self._stepped_up_s = now_s


class Resolutions:
    """The resolution of the next frame."""

    def __init__(self, frame_ms: float) -> None:
        """``frame_ms`` is how long a frame may take."""
        tiers = [Tier(name, cost) for name, cost in SHARES.items()]
        self._controller = TierController(tiers, frame_ms)

    def chosen(self, wanted: str) -> str:
        """FULL or HALF, for the viewer's wish: FULL, HALF or AUTO."""
        return self._controller.name if wanted == AUTO else wanted

    def observe(self, now_s: float, stages_ms: dict[str, float], frame_ms: float) -> None:
        """A frame was worked out at :meth:`chosen` under AUTO; it took ``frame_ms``."""
        self._controller.observe(now_s, sum(stages_ms.get(name, 0.0) for name in PIXEL_STAGES), frame_ms)
