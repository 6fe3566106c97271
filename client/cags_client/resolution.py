"""How many pixels a frame is drawn, aligned and restored at: the display's own, or half of them a side.

At half everything up to the shown picture is worked out on a quarter of the pixels, through a footprint of its own, and
only that picture is brought up. With ``auto`` the client decides while it plays, by the controller of
:mod:`cags_client.restore.auto`: down as soon as frames take too long for a while, up again after a longer one.
"""

from __future__ import annotations

from cags_client.restore.auto import Tier, TierController
from cags_client.settings import AUTO, FULL, HALF

PIXEL_STAGES = ("raster", "align", "restore", "enlarge")
"""Stages whose time is one of pixels."""

SHARES = {HALF: 4.0, FULL: 10.0}
"""What these stages take together, one resolution against the other (measured: 0.35 to 0.45), in units of the load."""


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
