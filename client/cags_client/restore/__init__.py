"""Colour restoration behind one seam: ``create(name) -> Restorer``."""

from __future__ import annotations

from collections.abc import Callable

from cags_client.restore.affine import AffineRestorer
from cags_client.restore.base import RestoreInput, Restorer
from cags_client.restore.none import NoRestorer
from cags_client.restore.reference import ReferenceRestorer
from cags_common.errors import ConfigError

__all__ = ["RESTORERS", "RestoreInput", "Restorer", "create"]

RESTORERS: dict[str, Callable[[], Restorer]] = {
    "none": NoRestorer,
    "reference": ReferenceRestorer,
    "affine": AffineRestorer,
}
"""Restorers by name, cheapest first."""


def create(name: str) -> Restorer:
    """The restorer called ``name``. Raises :class:`ConfigError` for an unknown one."""
    if name not in RESTORERS:
        raise ConfigError(f"restorer {name!r} is unknown; known: {', '.join(RESTORERS)}")
    return RESTORERS[name]()
