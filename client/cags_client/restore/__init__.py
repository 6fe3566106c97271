"""Colour restoration behind one seam: ``create(name) -> Restorer``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING

from cags_client.restore.affine import AffineRestorer
from cags_client.restore.base import RestoreInput, Restorer
from cags_client.restore.none import NoRestorer
from cags_client.restore.reference import ReferenceRestorer
from cags_common.errors import ConfigError

if TYPE_CHECKING:
    from cags_client.restore.networks.weights import Weights

__all__ = ["RESTORERS", "RestoreInput", "Restorer", "create"]


def _network(name: str, threads: int | None = None, weights: Weights | None = None) -> Restorer:
    from cags_client.restore import networks

    if weights is not None:
        return networks.from_weights(weights, name.partition("@")[2], threads)
    return networks.create(name, threads)


RESTORERS: dict[str, Callable[[], Restorer]] = {
    "none": NoRestorer,
    "reference": ReferenceRestorer,
    "affine": AffineRestorer,
    **{name: partial(_network, name) for name in ("lite", "srresnet", "sr-align-ref", "cr-no-ref")},
}
"""Restorers by name, cheapest first. Networks need weights: those of the product, or of the content."""


REPLACING = frozenset({"reference", "sr-align-ref", "cr-no-ref"})
"""Restorers that do not correct the distorted picture but stand in its place: they run at the highest LoD too."""


NETWORK_NAMES = frozenset({"lite", "srresnet", "sr-align-ref", "cr-no-ref"})


def create(name: str, *, threads: int | None = None, weights: Mapping[str, Weights] | None = None) -> Restorer:
    """The restorer called ``name``; a network's may name its runtime (``lite@openvino``).

    ``weights`` are the content's own, by network; they come before those of the program. ``threads`` None leaves their
    number to the restorer. Raises :class:`ConfigError` for an unknown one.
    """
    check_name(name)
    network = name.partition("@")[0]
    if network in NETWORK_NAMES:
        return _network(name, threads, (weights or {}).get(network))
    return RESTORERS[name]()


def check_name(name: str) -> None:
    """Raise :class:`ConfigError` where there is no restorer called ``name``; nothing is loaded."""
    if name not in RESTORERS and name.partition("@")[0] not in NETWORK_NAMES:
        raise ConfigError(f"restorer {name!r} is unknown; known: {', '.join(RESTORERS)}")
