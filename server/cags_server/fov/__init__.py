"""How wide to render the reference: policies behind one seam, picked by name."""

from __future__ import annotations

from collections.abc import Callable

from cags_common.errors import ConfigError
from cags_server.fov.base import MAX_REFERENCE_FOV_RAD, FovObservation, FovPolicy, widened
from cags_server.fov.fixed import FixedFov

FOV_POLICIES: dict[str, Callable[[float], FovPolicy]] = {"fixed": FixedFov}
"""Every policy by name; the number is the margin that ``fixed`` uses."""


def create_fov_policy(name: str, margin: float) -> FovPolicy:
    """The policy called ``name``. Raises :class:`ConfigError` for an unknown one."""
    if name not in FOV_POLICIES:
        raise ConfigError(f"fov = {name!r} is unknown; known: {', '.join(FOV_POLICIES)}")
    return FOV_POLICIES[name](margin)


__all__ = ["FOV_POLICIES", "MAX_REFERENCE_FOV_RAD", "FovObservation", "FovPolicy", "create_fov_policy", "widened"]
