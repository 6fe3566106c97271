"""PyTorch, eagerly. On the CPU measured within a fifth of the fastest runtime, with nothing to install or compile."""

from __future__ import annotations

import numpy as np
import torch
from torch import nn

from cags_common.errors import ConfigError
from cags_common.geometry import F32


class TorchRuntime:
    """Channels-last inference on ``device``."""

    def __init__(self, network: nn.Module, threads: int | None = None, *, device: str = "cpu") -> None:
        if device.startswith("cuda") and not torch.cuda.is_available():
            raise ConfigError("runtime 'cuda' needs a CUDA device and a CUDA build of torch; use 'torch'")
        self.name = "torch" if device == "cpu" else device
        self._device = torch.device(device)
        self._network = channels_last(network.eval(), self._device)
        if threads is not None and device == "cpu":
            torch.set_num_threads(threads)

    def run(self, *images: F32) -> F32:
        """See :class:`cags_research.restore.networks.runtimes.Runtime`."""
        with torch.inference_mode():
            tensors = [torch.from_numpy(np.ascontiguousarray(image))[None].to(self._device) for image in images]
            answer: F32 = self._network(*tensors)[0].cpu().numpy()
        return answer


def channels_last(network: nn.Module, device: torch.device) -> nn.Module:
    """``network`` on ``device`` with its convolutions in the memory order of pictures."""
    moved: nn.Module = network.to(device).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return moved
