"""What is done with references: ``correct`` adds what is lacking; the others are there to compare with.

``create(name) -> Restorer`` makes the restorers of aligned pictures: the paper's networks, and the aligned reference
alone. ``correct`` and ``none`` need none.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING

from cags_client.frame.restore.base import RestoreInput, Restorer
from cags_client.frame.restore.reference import ReferenceRestorer
from cags_common.errors import ConfigError
from cags_protocol.messages import ANY_REFERENCE, NO_REFERENCES, PICTURES_ONLY

if TYPE_CHECKING:
    from cags_client.frame.restore.networks.weights import Weights

__all__ = [
    "CORRECT",
    "NONE",
    "RESTORERS",
    "RestoreInput",
    "Restorer",
    "check_name",
    "create",
    "references_wanted",
    "switchable",
]

CORRECT, NONE = "correct", "none"
"""What needs no restorer: adding what is lacking, and nothing."""


def _network(name: str, threads: int | None = None, weights: Weights | None = None) -> Restorer:
    from cags_client.frame.restore import networks

    if weights is not None:
        return networks.from_weights(weights, name.partition("@")[2], threads)
    return networks.create(name, threads)


NETWORK_NAMES = ("srresnet", "sr-align-ref", "cr-no-ref")

RESTORERS: dict[str, Callable[[], Restorer]] = {
    "reference": ReferenceRestorer,
    **{name: partial(_network, name) for name in NETWORK_NAMES},
}
"""Restorers of aligned pictures by name; a network may name its runtime (``srresnet@openvino``)."""

REPLACING = frozenset({"reference", "sr-align-ref", "cr-no-ref"})
"""Restorers that do not correct the distorted picture but stand in its place: they run at the highest LoD too."""


def create(name: str, *, threads: int | None = None, weights: Mapping[str, Weights] | None = None) -> Restorer:
    """The restorer of aligned pictures called ``name``; a network's may name its runtime (``srresnet@openvino``).

    ``weights`` are the content's own, by network; they come before those of the program. ``threads`` None leaves their
    number to the restorer. Raises :class:`ConfigError` for an unknown one.
    """
    check_name(name)
    network = name.partition("@")[0]
    if network in NETWORK_NAMES:
        return _network(name, threads, (weights or {}).get(network))
    if name not in RESTORERS:
        raise ConfigError(f"restorer {name!r} works on no aligned picture; these do: {', '.join(RESTORERS)}")
    return RESTORERS[name]()


def check_name(name: str) -> None:
    """Raise :class:`ConfigError` where nothing called ``name`` can be done with references; nothing is loaded."""
    if name not in (CORRECT, NONE, *RESTORERS) and name.partition("@")[0] not in NETWORK_NAMES:
        raise ConfigError(f"restorer {name!r} is unknown; known: {', '.join((CORRECT, NONE, *RESTORERS))}")


def references_wanted(name: str) -> str:
    """Which references a client asks for that begins with ``name``."""
    return {CORRECT: ANY_REFERENCE, NONE: NO_REFERENCES}.get(name, PICTURES_ONLY)


def switchable(name: str) -> tuple[str, ...]:
    """What a viewer that began with ``name`` can change to, by the references that it gets."""
    if name == NONE:
        return (NONE,)
    return (CORRECT, NONE) if name == CORRECT else tuple(dict.fromkeys((name, CORRECT, NONE, *RESTORERS)))
