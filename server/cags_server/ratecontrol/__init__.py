"""What to send within the budget: rate policies behind one seam, picked by name."""

from __future__ import annotations

from collections.abc import Callable

from cags_common.registry import Registry
from cags_server.ratecontrol.base import Decision, Observation, RatePolicy, TileView, Upgrade
from cags_server.ratecontrol.utility import UtilityPolicy

RATE_POLICIES: Registry[Callable[[], RatePolicy]] = Registry("abr =", "cags.rate_policies", {"utility": UtilityPolicy})
"""Policies by name."""


def create_rate_policy(name: str) -> RatePolicy:
    """The policy called ``name``. Raises :class:`~cags_common.errors.ConfigError` for an unknown one."""
    return RATE_POLICIES.find(name)()


__all__ = ["RATE_POLICIES", "Decision", "Observation", "RatePolicy", "TileView", "Upgrade", "create_rate_policy"]
