"""Restoration by networks: the paper's ``srresnet``, and the baselines with one input.

``create("srresnet")`` gives a restorer with the weights that come with the program; ``create("srresnet@openvino")``
runs it by another runtime. Nothing here imports torch until a network is made.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from cags_client.frame.restore.networks.weights import Weights
from cags_common.errors import ConfigError
from cags_common.openmp import yield_cores

if TYPE_CHECKING:
    from torch import nn

    from cags_client.frame.restore.base import Restorer

__all__ = ["NETWORKS", "Weights", "create", "from_weights"]

yield_cores()

NETWORKS = ("srresnet", "sr-align-ref", "cr-no-ref")
"""Networks by name."""


def create(spec: str, threads: int | None = None) -> Restorer:
    """The restorer ``NAME`` or ``NAME@RUNTIME`` with the weights that come with the program.

    Raises :class:`ConfigError` for an unknown name, missing weights, or a runtime that is not there.
    """
    name, _, runtime = spec.partition("@")
    if name not in NETWORKS:
        raise ConfigError(f"network {name!r} is unknown; known: {', '.join(NETWORKS)}")
    return from_weights(Weights.shipped(name), runtime, threads)


def from_weights(weights: Weights, runtime: str = "", threads: int | None = None) -> Restorer:
    """The restorer that ``weights`` are for (per-scene weights of a bundle, for one). Raises :class:`ConfigError`."""
    from cags_client.frame.restore.networks import runtimes
    from cags_client.frame.restore.networks.restorer import PictureRestorer

    ready = runtimes.create(runtime or runtimes.DEFAULT, weights, threads)
    name = f"{weights.network}@{runtime}" if runtime else weights.network
    return PictureRestorer(ready, name, fall_back=weights.network == "srresnet")


def network_of(weights: Weights) -> nn.Module:
    """The network of ``weights``, filled with them. Raises :class:`ConfigError` where they do not fit."""
    import torch

    network = _new(weights.network)
    wanted = {name: tuple(p.shape) for name, p in network.named_parameters()}
    given = {name: array.shape for name, array in weights.arrays.items()}
    if wanted != given:
        odd = sorted(set(wanted.items()) ^ set(given.items()))[0][0]
        raise ConfigError(f"weights of {weights.network!r}: array {odd!r} is missing, unknown or of another shape")
    network.load_state_dict({name: torch.from_numpy(array.copy()) for name, array in weights.arrays.items()})
    return network


def _new(name: str) -> nn.Module:
    from cags_client.frame.restore.networks.srresnet import Sees, SrResNet

    makers: Mapping[str, Callable[[], nn.Module]] = {
        "srresnet": lambda: SrResNet(Sees.BOTH),
        "sr-align-ref": lambda: SrResNet(Sees.REFERENCE),
        "cr-no-ref": lambda: SrResNet(Sees.DISTORTED),
    }
    if name not in makers:
        raise ConfigError(f"weights are for network {name!r}, which this program does not know: {', '.join(makers)}")
    return makers[name]()
