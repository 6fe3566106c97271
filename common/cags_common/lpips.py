"""LPIPS, the learned perceptual distance (Zhang et al. 2018), AlexNet variant, version 0.1.

The weights are a file that the user gives by path: an ``.npz`` with ``conv{i}.weight`` (OIHW), ``conv{i}.bias``
and ``lin{i}.weight`` for i in 0..4. Nothing is downloaded.
"""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from cags_common.errors import ConfigError
from cags_common.geometry import F32
from cags_common.openmp import yield_cores

yield_cores()

import torch  # noqa: E402
from torch import Tensor  # noqa: E402
from torch.nn import functional  # noqa: E402

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

    def __init__(self, weights: str | Path, device: str = "cpu") -> None:
        """Read the weights. Raises :class:`ConfigError` naming the file when it is missing or of another layout."""
        arrays = _read_weights(Path(weights))
        self.device = torch.device(device)

        def tensor(name: str) -> Tensor:
            return torch.from_numpy(np.ascontiguousarray(arrays[name], dtype=np.float32)).to(self.device)

        self._convolutions = [(tensor(f"conv{i}.weight"), tensor(f"conv{i}.bias")) for i in range(5)]
        self._linear = [tensor(f"lin{i}.weight").reshape(1, -1, 1, 1) for i in range(5)]
        self._shift = torch.tensor(SHIFT, device=self.device).reshape(1, 3, 1, 1)
        self._scale = torch.tensor(SCALE, device=self.device).reshape(1, 3, 1, 1)

    @torch.inference_mode()
    def distance(self, a: F32, b: F32) -> float:
        """Distance of two images [H, W, 3] in [0, 1] of equal size, at least 31 pixels a side."""
        if a.shape != b.shape or min(a.shape[:2]) < SMALLEST_SIDE_PX:
            raise ValueError(
                f"images {a.shape} and {b.shape} must be equal in size and at least {SMALLEST_SIDE_PX} px a side"
            )
        total = torch.zeros((), device=self.device)
        for weight, x, y in zip(self._linear, self._features(a), self._features(b), strict=True):
            total += ((_unit(x) - _unit(y)).square() * weight).sum(dim=1).mean()
        return float(total)

    def _features(self, image: F32) -> list[Tensor]:
        x = torch.from_numpy(np.ascontiguousarray(image, dtype=np.float32)).to(self.device)
        x = (x.permute(2, 0, 1)[None] * 2 - 1 - self._shift) / self._scale
        features = []
        for index, ((weight, bias), (stride, padding)) in enumerate(zip(self._convolutions, CONVOLUTIONS, strict=True)):
            if index in POOLED_BEFORE:
                x = functional.max_pool2d(x, kernel_size=3, stride=2)
            x = functional.relu(functional.conv2d(x, weight, bias, stride=stride, padding=padding))
            features.append(x)
        return features


def _unit(x: Tensor) -> Tensor:
    return x / (x.square().sum(dim=1, keepdim=True).sqrt() + EPSILON)


def _read_weights(path: Path) -> dict[str, np.ndarray]:
    names = [f"conv{i}.{part}" for i in range(5) for part in ("weight", "bias")] + [f"lin{i}.weight" for i in range(5)]
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            return {name: archive[name] for name in names}
    except (OSError, EOFError, TypeError, ValueError, zipfile.BadZipFile, KeyError) as error:
        raise ConfigError(
            f"{path}: is not an LPIPS weights file ({error}); give an .npz with conv0..4 and lin0..4"
        ) from error
