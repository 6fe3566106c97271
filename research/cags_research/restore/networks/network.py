"""Networks by name, filled with their weights."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from cags_common.errors import ConfigError
from cags_research.restore.networks.weights import Weights

if TYPE_CHECKING:
    from torch import nn


def network_of(weights: Weights) -> nn.Module:
    """The network of ``weights``, filled with them. Raises :class:`ConfigError` where they do not fit."""
    import torch

    network = _new(weights.network, gated=weights.gated)
    wanted = {name: tuple(p.shape) for name, p in network.named_parameters()}
    given = {name: array.shape for name, array in weights.arrays.items()}
    if wanted != given:
        odd = sorted(set(wanted.items()) ^ set(given.items()))[0][0]
        raise ConfigError(
            f"weights of {weights.network!r}: array {odd!r} is missing, unknown or of another shape; "
            "train them anew with 'cags-train restore'"
        )
    network.load_state_dict({name: torch.from_numpy(array.copy()) for name, array in weights.arrays.items()})
    return network


def _new(name: str, *, gated: bool) -> nn.Module:
    from cags_research.restore.networks.srresnet import Sees, SrResNet

    makers: Mapping[str, Callable[[], nn.Module]] = {
        "srresnet": lambda: SrResNet(Sees.BOTH, gated=gated),
        "sr-align-ref": lambda: SrResNet(Sees.REFERENCE),
        "cr-no-ref": lambda: SrResNet(Sees.DISTORTED),
    }
    if name not in makers:
        raise ConfigError(f"weights are for network {name!r}, which this program does not know: {', '.join(makers)}")
    return makers[name]()
