"""LPIPS, the learned perceptual distance (Zhang et al. 2018), AlexNet variant, version 0.1.

The weights are a file that the user gives by path: an ``.npz`` with ``conv{i}.weight`` (OIHW), ``conv{i}.bias``
and ``lin{i}.weight`` for i in 0..4. Nothing is downloaded.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from cags_common.errors import ConfigError
from cags_common.geometry import F32

# stride and padding of AlexNet's five convolutions; a 3x3 max-pool of stride 2 precedes the second and the third
CONVOLUTIONS = ((4, 2), (1, 2), (1, 1), (1, 1), (1, 1))
POOLED_BEFORE = (1, 2)

# the affine map of [-1, 1] images that the published weights expect
SHIFT = (-0.030, -0.088, -0.188)
SCALE = (0.458, 0.448, 0.450)

EPSILON = 1e-10
SMALLEST_SIDE_PX = 31
"""AlexNet's two pools leave nothing of a smaller image."""


class Lpips:
    """Distance between two images; 0 for equal ones, about 0.7 for unrelated ones."""

    def __init__(self, weights: str | Path) -> None:
        """Read the weights. Raises :class:`ConfigError` naming the file when it is missing or of another layout."""
        arrays = {name: np.asarray(array, np.float32) for name, array in _read_weights(Path(weights)).items()}
        self._convolutions = [(arrays[f"conv{i}.weight"], arrays[f"conv{i}.bias"]) for i in range(5)]
        self._linear = [arrays[f"lin{i}.weight"].reshape(-1) for i in range(5)]

    def distance(self, a: F32, b: F32) -> float:
        """Distance of two images [H, W, 3] in [0, 1] of equal size, at least 31 pixels a side."""
        if a.shape != b.shape or min(a.shape[:2]) < SMALLEST_SIDE_PX:
            raise ValueError(
                f"images {a.shape} and {b.shape} must be equal in size and at least {SMALLEST_SIDE_PX} px a side"
            )
        layers = zip(self._linear, self._features(a), self._features(b), strict=True)
        return float(sum((np.square(_unit(x) - _unit(y)) @ weight).mean() for weight, x, y in layers))

    def _features(self, image: F32) -> Iterator[F32]:
        """What AlexNet's five layers [H', W', C] say of ``image`` [H, W, 3]."""
        x = ((image * 2 - 1 - np.array(SHIFT, np.float32)) / np.array(SCALE, np.float32)).astype(np.float32)
        for index, ((weight, bias), (stride, padding)) in enumerate(zip(self._convolutions, CONVOLUTIONS, strict=True)):
            if index in POOLED_BEFORE:
                x = _pooled(x)
            x = np.maximum(_convolved(x, weight, stride, padding) + bias, 0)
            yield x


def _convolved(x: F32, weight: F32, stride: int, padding: int) -> F32:
    """``x`` [H, W, C] under kernels ``weight`` [C', C, k, k], zeros around it."""
    bordered = np.pad(x, ((padding, padding), (padding, padding), (0, 0)))
    windows = sliding_window_view(bordered, weight.shape[2:], axis=(0, 1))[::stride, ::stride]  # [H', W', C, k, k]
    return np.tensordot(windows, weight, axes=((2, 3, 4), (1, 2, 3)))


def _pooled(x: F32) -> F32:
    """Largest of every second 3x3 window."""
    largest: F32 = sliding_window_view(x, (3, 3), axis=(0, 1))[::2, ::2].max(axis=(-2, -1))
    return largest


def _unit(x: F32) -> F32:
    """Features [H, W, C] of length 1 at every pixel."""
    return np.asarray(x / (np.sqrt(np.square(x).sum(axis=-1, keepdims=True)) + EPSILON), dtype=np.float32)


def _read_weights(path: Path) -> dict[str, np.ndarray]:
    names = [f"conv{i}.{part}" for i in range(5) for part in ("weight", "bias")] + [f"lin{i}.weight" for i in range(5)]
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            return {name: archive[name] for name in names}
    except (OSError, EOFError, TypeError, ValueError, zipfile.BadZipFile, KeyError) as error:
        raise ConfigError(
            f"{path}: is not an LPIPS weights file ({error}); give an .npz with conv0..4 and lin0..4"
        ) from error
