"""What runs a network: a seam of one call, picked by name.

``torch`` needs nothing more than the program itself; ``openvino`` and ``onnxruntime`` are the extra
``cags-stream[runtimes]`` and answer the same to 1e-3 (measured: 1e-7).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

from cags_common.errors import ConfigError
from cags_common.geometry import F32

if TYPE_CHECKING:
    from torch import nn

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


Factory = Callable[["nn.Module", int | None], Runtime]


def _torch(network: nn.Module, threads: int | None) -> Runtime:
    from cags_client.restore.networks.runtimes.torch_eager import TorchRuntime

    return TorchRuntime(network, threads)


def _cuda(network: nn.Module, threads: int | None) -> Runtime:
    from cags_client.restore.networks.runtimes.torch_eager import TorchRuntime

    return TorchRuntime(network, threads, device="cuda")


def _openvino(network: nn.Module, threads: int | None) -> Runtime:
    from cags_client.restore.networks.runtimes.openvino_cpu import OpenVinoRuntime

    return OpenVinoRuntime(network, threads)


def _onnxruntime(network: nn.Module, threads: int | None) -> Runtime:
    from cags_client.restore.networks.runtimes.onnx_cpu import OnnxRuntime

    return OnnxRuntime(network, threads)


RUNTIMES: dict[str, Factory] = {
    "torch": _torch,
    "cuda": _cuda,
    "openvino": _openvino,
    "onnxruntime": _onnxruntime,
}
"""Runtimes by name."""


def create(name: str, network: nn.Module, threads: int | None = None) -> Runtime:
    """``network`` made ready by the runtime ``name``; ``threads`` None leaves the number to the runtime.

    Raises :class:`ConfigError` for an unknown runtime, or one whose package or device is not there.
    """
    if name not in RUNTIMES:
        raise ConfigError(f"runtime {name!r} is unknown; known: {', '.join(RUNTIMES)}")
    try:
        return RUNTIMES[name](network, threads)
    except ImportError as error:
        raise ConfigError(
            f"runtime {name!r} needs the package {error.name}; install cags-stream[runtimes], or use {DEFAULT!r}"
        ) from error
