"""What runs a network: a seam of one call, picked by name.

``torch`` needs nothing more than the program itself; ``openvino`` and ``onnxruntime`` are the extra
``cags-stream[runtimes]``. All answer the same to 1e-3 (measured: 1e-5 and less).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

from cags_common.errors import ConfigError
from cags_common.geometry import F32

if TYPE_CHECKING:
    from torch import nn

    from cags_research.restore.networks.weights import Weights


DEFAULT = "torch"


class Runtime(Protocol):
    """A network made ready to run. Not thread-safe."""

    @property
    def name(self) -> str:
        """Name in the registry."""
        ...

    def run(self, *images: F32) -> F32:
        """The network's answer [h, w, C'] to ``images`` [h, w, C] float32, one for each of its inputs."""
        ...


Factory = Callable[["Weights", int | None], Runtime]


def _network(weights: Weights) -> nn.Module:
    from cags_research.restore.networks.network import network_of

    return network_of(weights)


def _torch(weights: Weights, threads: int | None) -> Runtime:
    from cags_research.restore.networks.runtimes.torch_eager import TorchRuntime

    return TorchRuntime(_network(weights), threads)


def _cuda(weights: Weights, threads: int | None) -> Runtime:
    from cags_research.restore.networks.runtimes.torch_eager import TorchRuntime

    return TorchRuntime(_network(weights), threads, device="cuda")


def _openvino(weights: Weights, threads: int | None) -> Runtime:
    from cags_research.restore.networks.runtimes.openvino_cpu import OpenVinoRuntime

    return OpenVinoRuntime(_network(weights), threads)


def _onnxruntime(weights: Weights, threads: int | None) -> Runtime:
    from cags_research.restore.networks.runtimes.onnx_cpu import OnnxRuntime

    return OnnxRuntime(_network(weights), threads)


RUNTIMES: dict[str, Factory] = {
    "torch": _torch,
    "cuda": _cuda,
    "openvino": _openvino,
    "onnxruntime": _onnxruntime,
}
"""Runtimes by name."""


def create(name: str, weights: Weights, threads: int | None = None) -> Runtime:
    """The network of ``weights``, made ready by the runtime ``name``; ``threads`` None leaves their number to it.

    Raises :class:`ConfigError` for an unknown runtime, one whose package or device is not there, and weights that
    do not fit their network.
    """
    if name not in RUNTIMES:
        raise ConfigError(f"runtime {name!r} is unknown; known: {', '.join(RUNTIMES)}")
    try:
        return RUNTIMES[name](weights, threads)
    except ImportError as error:
        raise ConfigError(
            f"runtime {name!r} needs the package {error.name}; install cags-stream[runtimes], or name no runtime"
        ) from error
