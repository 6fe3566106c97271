"""What to send within the budget: rate policies behind one seam, picked by name."""

from __future__ import annotations

from collections.abc import Callable

from cags_common.errors import ConfigError
from cags_server.ratecontrol.base import Decision, Observation, RatePolicy, TileView, Upgrade
from cags_server.ratecontrol.buffer import BufferPolicy
from cags_server.ratecontrol.none import NoTilesPolicy
from cags_server.ratecontrol.paper import PaperPolicy
from cags_server.ratecontrol.utility import UtilityPolicy

RATE_POLICIES: dict[str, Callable[[], RatePolicy]] = {
    "paper": PaperPolicy,
    "utility": UtilityPolicy,
    "buffer": BufferPolicy,
    "none": NoTilesPolicy,
}
"""Every policy by name."""


def create_rate_policy(name: str) -> RatePolicy:
    """The policy called ``name``. Raises :class:`ConfigError` for an unknown one."""
    if name not in RATE_POLICIES:
        raise ConfigError(f"abr = {name!r} is unknown; known: {', '.join(RATE_POLICIES)}")
    return RATE_POLICIES[name]()


__all__ = ["RATE_POLICIES", "Decision", "Observation", "RatePolicy", "TileView", "Upgrade", "create_rate_policy"]
