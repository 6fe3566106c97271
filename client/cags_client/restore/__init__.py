"""Colour restoration behind one seam: ``create(name) -> Restorer``."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from cags_client.restore.affine import AffineRestorer
from cags_client.restore.base import RestoreInput, Restorer
from cags_client.restore.none import NoRestorer
from cags_client.restore.reference import ReferenceRestorer
from cags_common.errors import ConfigError

__all__ = ["RESTORERS", "RestoreInput", "Restorer", "create"]


def _network(name: str) -> Restorer:
    from cags_client.restore import networks

    return networks.create(name)


RESTORERS: dict[str, Callable[[], Restorer]] = {
    "none": NoRestorer,
    "reference": ReferenceRestorer,
    "affine": AffineRestorer,
    **{name: partial(_network, name) for name in ("lite", "srresnet", "sr-align-ref", "cr-no-ref")},
}
"""Restorers by name, cheapest first. Networks need weights: those of the product, or of the content."""


REPLACING = frozenset({"reference", "sr-align-ref", "cr-no-ref"})
"""Restorers that do not correct the distorted picture but stand in its place: they run at the highest LoD too."""


def create(name: str) -> Restorer:
    """The restorer called ``name``; a network's may name its runtime (``lite@openvino``).

    Raises :class:`ConfigError` for an unknown one.
    """
    if name.partition("@")[0] in RESTORERS and "@" in name:
        return _network(name)
    if name not in RESTORERS:
        raise ConfigError(f"restorer {name!r} is unknown; known: {', '.join(RESTORERS)}")
    return RESTORERS[name]()
