"""OpenVINO on the CPU: a little faster than eager torch. Models are compiled for each size of picture when it first
comes.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import openvino
import torch
from torch import nn

from cags_common.geometry import F32


class OpenVinoRuntime:
    """Float32 inference, tuned for latency."""

    name = "openvino"

    def __init__(self, network: nn.Module, threads: int | None = None) -> None:
        self._network = network.eval()
        self._core = openvino.Core()
        self._config: dict[str, Any] = {"PERFORMANCE_HINT": "LATENCY", "INFERENCE_PRECISION_HINT": "f32"}
        if threads is not None:
            self._config["INFERENCE_NUM_THREADS"] = threads
        self._ready: tuple[tuple[tuple[int, ...], ...], Any] | None = None

    def run(self, *images: F32) -> F32:
        """See :class:`cags_research.restore.networks.runtimes.Runtime`."""
        batch = [np.ascontiguousarray(image)[None] for image in images]
        answer = self._request(batch).infer(batch, share_inputs=True)[0][0]
        return np.asarray(answer, dtype=np.float32)

    def _request(self, batch: list[F32]) -> Any:
        shapes = tuple(image.shape for image in batch)
        if self._ready is None or self._ready[0] != shapes:
            with warnings.catch_warnings(), torch.inference_mode():
                warnings.simplefilter("ignore")  # tracing tells of its deprecation and of sizes becoming constants
                model = openvino.convert_model(
                    self._network,
                    example_input=tuple(torch.from_numpy(image) for image in batch),
                    input=[openvino.PartialShape(list(shape)) for shape in shapes],
                )
            compiled = self._core.compile_model(model, "CPU", self._config)
            self._ready = shapes, compiled.create_infer_request()
        return self._ready[1]
