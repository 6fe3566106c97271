"""Restoration by networks: the paper's ``srresnet``, and the variants of it that see one picture.

``create("srresnet")`` gives a restorer with the weights that come with this package, ``create("srresnet@openvino")``
runs it by another runtime. Torch must be installed; it is imported when a network is made.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING

from cags_common.errors import ConfigError
from cags_research.openmp import yield_cores
from cags_research.restore.networks.network import network_of
from cags_research.restore.networks.weights import Weights

if TYPE_CHECKING:
    from cags_client.frame.restore import Restorer

__all__ = ["NETWORKS", "Weights", "create", "from_weights", "network_of"]

yield_cores()  # before torch is imported
if find_spec("torch") is None:
    raise ModuleNotFoundError("No module named 'torch'", name="torch")  # now, not when the first frame is drawn

NETWORKS = ("srresnet", "sr-align-ref", "cr-no-ref")
"""Networks by name."""


def create(spec: str, threads: int | None = None) -> Restorer:
    """The restorer ``NAME`` or ``NAME@RUNTIME`` with the weights that come with this package.

    Raises :class:`ConfigError` for an unknown name, missing weights, or a runtime that is not there.
    """
    name, _, runtime = spec.partition("@")
    if name not in NETWORKS:
        raise ConfigError(f"network {name!r} is unknown; known: {', '.join(NETWORKS)}")
    return from_weights(Weights.shipped(name), runtime, threads)


def from_weights(weights: Weights, runtime: str = "", threads: int | None = None) -> Restorer:
    """The restorer that ``weights`` are for (per-scene weights of a bundle, for one). Raises :class:`ConfigError`."""
    from cags_research.restore.networks import runtimes
    from cags_research.restore.networks.restorer import PictureRestorer

    ready = runtimes.create(runtime or runtimes.DEFAULT, weights, threads)
    name = f"{weights.network}@{runtime}" if runtime else weights.network
    return PictureRestorer(ready, name, replaces=weights.network != "srresnet", gated=weights.gated)
