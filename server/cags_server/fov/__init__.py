"""How wide to render the reference: policies behind one seam, picked by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from cags_common.registry import Registry
from cags_server.fov.base import MAX_REFERENCE_FOV_RAD, FovObservation, FovPolicy, widened
from cags_server.fov.fixed import FixedFov
from cags_server.fov.lstm import LstmFov
from cags_server.fov.quantile import QuantileFov


@dataclass(frozen=True)
class FovOptions:
    """Numbers of the policies; each uses its own."""

    margin: float = 0.1
    quantile: float = 0.9
    gain: float = 0.7


FOV_POLICIES: Registry[Callable[[FovOptions], FovPolicy]] = Registry(
    "fov =",
    "cags.fov_policies",
    {
        "fixed": lambda options: FixedFov(options.margin),
        "quantile": lambda options: QuantileFov(options.quantile),
        "lstm": lambda options: LstmFov(options.gain),
    },
)
"""Policies by name."""


def create_fov_policy(name: str, options: FovOptions | None = None) -> FovPolicy:
    """The policy called ``name``.

    Raises :class:`~cags_common.errors.ConfigError` for an unknown one, or weights that cannot be read.
    """
    return FOV_POLICIES.find(name)(options or FovOptions())


__all__ = [
    "FOV_POLICIES",
    "MAX_REFERENCE_FOV_RAD",
    "FovObservation",
    "FovOptions",
    "FovPolicy",
    "create_fov_policy",
    "widened",
]
