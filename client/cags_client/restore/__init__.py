"""What is done with references: ``correct`` adds what is lacking; the others are there to compare with.

``create(name) -> Restorer`` makes the restorers of aligned pictures: the paper's networks, and the aligned reference
alone. ``correct`` and ``none`` need none.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from cags_client.restore.base import RestoreInput, Restorer
from cags_client.restore.reference import ReferenceRestorer
from cags_common.errors import ConfigError
from cags_protocol.messages import ANY_REFERENCE, NO_REFERENCES, PICTURES_ONLY

if TYPE_CHECKING:
    from cags_client.restore.networks.weights import Weights

__all__ = ["CORRECT", "NONE", "RESTORERS", "RestoreInput", "Restorer", "create", "references_wanted", "switchable"]

CORRECT, NONE, REFERENCE = "correct", "none", "reference"

NETWORK_NAMES = ("srresnet", "sr-align-ref", "cr-no-ref")

RESTORERS: dict[str, Callable[[], Restorer] | None] = {
    CORRECT: None,
    NONE: None,
    REFERENCE: ReferenceRestorer,
    **dict.fromkeys(NETWORK_NAMES),
}
"""What can be done with references, by name; a network may name its runtime (``srresnet@openvino``). Restorers of
aligned pictures that are no networks come with what makes them; enter your own.
"""

REPLACING = frozenset({REFERENCE, "sr-align-ref", "cr-no-ref"})
"""Restorers that do not correct the distorted picture but stand in its place: they run at the highest LoD too."""


def create(name: str, *, threads: int | None = None, weights: Mapping[str, Weights] | None = None) -> Restorer:
    """The restorer of aligned pictures called ``name``; a network's may name its runtime (``srresnet@openvino``).

    ``weights`` are the content's own, by network; they come before those of the program. ``threads`` None leaves their
    number to the restorer. Raises :class:`ConfigError` for an unknown one.
    """
    check_name(name)
    network, _, runtime = name.partition("@")
    if network not in NETWORK_NAMES:
        made = RESTORERS[network]
        if made is None:
            others = ", ".join(other for other in RESTORERS if other not in (CORRECT, NONE))
            raise ConfigError(f"restorer {name!r} works on no aligned picture; one of {others} does")
        return made()
    from cags_client.restore import networks

    own = (weights or {}).get(network)
    return networks.create(name, threads) if own is None else networks.from_weights(own, runtime, threads)


def check_name(name: str) -> None:
    """Raise :class:`ConfigError` where there is no restorer called ``name``; nothing is loaded."""
    if name not in RESTORERS and name.partition("@")[0] not in NETWORK_NAMES:
        raise ConfigError(f"restorer {name!r} is unknown; known: {', '.join(RESTORERS)}")


def references_wanted(name: str) -> str:
    """Which references a client asks for that begins with ``name``."""
    return {CORRECT: ANY_REFERENCE, NONE: NO_REFERENCES}.get(name, PICTURES_ONLY)


def switchable(name: str) -> tuple[str, ...]:
    """What a viewer that began with ``name`` can change to, by the references that it gets."""
    if name == NONE:
        return (NONE,)
    return (CORRECT, NONE) if name == CORRECT else tuple(dict.fromkeys((name, CORRECT, *RESTORERS)))
