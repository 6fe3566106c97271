"""What is done with references: ``correct`` adds what the client's picture lacks, ``none`` leaves it alone.

``create(name) -> Restorer`` makes another kind: one that turns the client's picture and an aligned reference into the
picture to show. Those exist to be compared with (:mod:`cags_research.restore`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from cags_client.frame.restore.base import RestoreInput, Restorer, expected_errors, expected_psnr_db
from cags_common.errors import ConfigError
from cags_common.registry import Registry
from cags_protocol.wire.messages import ANY_REFERENCE, NO_REFERENCES, PICTURES_ONLY

__all__ = [
    "CORRECT",
    "NONE",
    "RESTORERS",
    "RestoreInput",
    "Restorer",
    "RestorerOptions",
    "check_name",
    "create",
    "expected_errors",
    "expected_psnr_db",
    "references_wanted",
    "switchable",
]

CORRECT, NONE = "correct", "none"
"""What needs no restorer: adding what is lacking, and nothing."""


@dataclass(frozen=True)
class RestorerOptions:
    """What a restorer is made with; each uses what it can."""

    runtime: str = ""
    """What runs its network (``openvino`` of ``srresnet@openvino``); empty: its default."""
    threads: int | None = None
    """Threads to compute on; None leaves their number to it."""
    weights: bytes | None = None
    """Weights file trained for the content, in place of those that come with the program."""


RESTORERS: Registry[Callable[[RestorerOptions], Restorer]] = Registry("restorer", "cags.restorers", {})
"""Restorers of aligned pictures by name."""


def create(name: str, *, threads: int | None = None, weights: bytes | None = None) -> Restorer:
    """The restorer of aligned pictures called ``name``; it may name what runs its network (``srresnet@openvino``).

    Raises :class:`ConfigError` for an unknown one, for one whose packages are not installed, and for ``weights`` that
    are no weights file.
    """
    if name in (CORRECT, NONE):
        raise ConfigError(f"restorer {name!r} works on no aligned picture; these do: {', '.join(RESTORERS.names())}")
    return _maker(name)(RestorerOptions(name.partition("@")[2], threads, weights))


def check_name(name: str) -> None:
    """Raise :class:`ConfigError` where nothing called ``name`` can be done with references here; no network is made."""
    if name not in (CORRECT, NONE):
        _maker(name)


def _maker(name: str) -> Callable[[RestorerOptions], Restorer]:
    kind, known = name.partition("@")[0], RESTORERS.names()
    if kind not in known:
        raise ConfigError(f"restorer {name!r} is unknown; known: {', '.join((CORRECT, NONE, *known))}")
    return RESTORERS.find(kind)


def references_wanted(name: str) -> str:
    """Which references a client asks for that begins with ``name``."""
    return {CORRECT: ANY_REFERENCE, NONE: NO_REFERENCES}.get(name, PICTURES_ONLY)


def switchable(name: str) -> tuple[str, ...]:
    """What a viewer that began with ``name`` can change to, by the references that it gets."""
    if name == NONE:
        return (NONE,)
    return (CORRECT, NONE) if name == CORRECT else tuple(dict.fromkeys((name, CORRECT, NONE, *RESTORERS)))
