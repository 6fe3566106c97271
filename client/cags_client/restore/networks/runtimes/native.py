"""``lite`` in ``cags-kernels``: convolutions by minimal filtering on the kernels' own threads. It needs no PyTorch."""

from __future__ import annotations

import os

import numpy as np

import cags_kernels
from cags_client.restore.networks.bounds import FACTOR_REACH, colour_reach
from cags_client.restore.networks.weights import Weights
from cags_common.errors import ConfigError
from cags_common.geometry import F32
from cags_kernels.lite import LiteKernel, LiteRun, LiteWeights

NETWORK = "lite"
BODY = "body."


class KernelsRuntime:
    """Float32 inference on the CPU."""

    name = "kernels"

    def __init__(self, weights: Weights, threads: int | None = None) -> None:
        if weights.network != NETWORK:
            raise ConfigError(f"runtime 'kernels' runs {NETWORK!r} alone; use 'torch' for {weights.network!r}")
        if not cags_kernels.native_available():
            raise ConfigError(f"runtime 'kernels' is not here: {cags_kernels.why_unavailable()}; use 'torch'")
        self._kernel = LiteKernel(_lite_weights(weights))
        self._threads = threads or os.cpu_count() or 1

    def run(self, *images: F32) -> F32:
        """See :class:`cags_client.restore.networks.runtimes.Runtime`."""
        own, reference, fields, noise = images
        features = np.asarray(noise).reshape(6)
        how = LiteRun(FACTOR_REACH, colour_reach(features), self._threads)
        return self._kernel.run(own, reference, fields, features, how)


def _lite_weights(weights: Weights) -> LiteWeights:
    arrays = dict(weights.arrays)
    layers = len([name for name in arrays if name.startswith(BODY)]) // 2
    try:
        made = LiteWeights(
            head=arrays.pop("head.weight"),
            head_bias=arrays.pop("head.bias"),
            noise=arrays.pop("noise.weight"),
            body=np.stack([arrays.pop(f"{BODY}{i}.weight") for i in range(layers)]),
            body_bias=np.stack([arrays.pop(f"{BODY}{i}.bias") for i in range(layers)]),
            tail=arrays.pop("tail.weight"),
            tail_bias=arrays.pop("tail.bias"),
        )
    except (KeyError, ValueError) as error:
        raise ConfigError(f"weights of {NETWORK!r} do not fit: {error}; train or fetch them again") from error
    if arrays:
        raise ConfigError(f"weights of {NETWORK!r}: array {sorted(arrays)[0]!r} is unknown; train or fetch them again")
    return made
