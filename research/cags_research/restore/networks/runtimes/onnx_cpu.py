"""ONNX Runtime on the CPU: a little faster than eager torch. Graphs are exported for each size of picture when it first
comes.
"""

from __future__ import annotations

import tempfile
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import torch
from torch import nn

from cags_common.geometry import F32

OPSET = 17


class OnnxRuntime:
    """Float32 inference in the calling process; its threads do not spin while they wait."""

    name = "onnxruntime"

    def __init__(self, network: nn.Module, threads: int | None = None) -> None:
        self._network = network.eval()
        self._options = onnxruntime.SessionOptions()
        self._options.log_severity_level = 3
        self._options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        if threads is not None:
            self._options.intra_op_num_threads = threads
        self._ready: tuple[tuple[tuple[int, ...], ...], Any] | None = None

    def run(self, *images: F32) -> F32:
        """See :class:`cags_research.restore.networks.runtimes.Runtime`."""
        batch = [np.ascontiguousarray(image)[None] for image in images]
        named = {f"image_{i}": image for i, image in enumerate(batch)}
        answer = self._session(batch).run(None, named)[0][0]
        return np.asarray(answer, dtype=np.float32)

    def _session(self, batch: list[F32]) -> Any:
        shapes = tuple(image.shape for image in batch)
        if self._ready is None or self._ready[0] != shapes:
            graph = _exported(self._network, batch)
            session = onnxruntime.InferenceSession(graph, self._options, providers=["CPUExecutionProvider"])
            self._ready = shapes, session
        return self._ready[1]


def _exported(network: nn.Module, batch: list[F32]) -> bytes:
    tensors = tuple(torch.from_numpy(image) for image in batch)
    names = [f"image_{i}" for i in range(len(batch))]
    with tempfile.TemporaryDirectory(prefix="cags-onnx-") as folder, warnings.catch_warnings(), torch.inference_mode():
        warnings.simplefilter("ignore")  # the exporter tells of its own deprecations and of sizes becoming constants
        path = Path(folder) / "network.onnx"
        torch.onnx.export(network, tensors, path, dynamo=False, opset_version=OPSET, input_names=names)
        return path.read_bytes()
