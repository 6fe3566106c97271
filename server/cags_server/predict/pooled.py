"""The offline-fitted weights of the autoregressive predictor: what they are applied to, and how they are stored.

A window is the last ``order`` increments of the motion, newest first, each as the rotation vector of the step (camera
axes) and the displacement of the step, turned into the axes of the newest camera. The displacement over the horizon, in
the same axes, is the window times a matrix [6 x order, 6]: all axes inform each other (who turns the head sideways also
tilts and shifts it). One matrix is fitted for every order and horizon, directly, not by recursion.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from cags_common import so3
from cags_common.errors import ConfigError, DecodeError
from cags_common.files import whole_file
from cags_common.geometry import F64
from cags_common.npz import load_npz

ORDERS = (1, 2, 4, 8, 12)
"""Window lengths: a short history uses a short window."""

HORIZON_STEPS = (*range(1, 16), 18, 21, 24, 27, 30)
"""Horizons fitted, in grid steps (33 ms to 1 s); those between are interpolated."""

MAX_WEIGHTS_BYTES = 4 << 20

SHIPPED = Path(__file__).parent / "weights" / "autoregressive.npz"


def windows(rotations: F64, positions: F64, order: int) -> F64:
    """[M, 6 x order] windows of a motion on the grid [N, 4], [N, 3]; row i ends at point ``order + i``; M = N - order.

    None (M = 0) where the motion is shorter than a window.
    """
    count = len(rotations) - order
    if count < 1:
        return np.zeros((0, 6 * order))
    turns = so3.log(so3.multiply(so3.conjugate(rotations[:-1]), rotations[1:]))
    moves = np.diff(positions, axis=0)
    steps = np.concatenate([turns, moves], axis=1)  # [N - 1, 6]
    views = np.lib.stride_tricks.sliding_window_view(steps, order, axis=0)  # [M, 6, order], oldest first
    out = np.array(views[:, :, ::-1].transpose(0, 2, 1))  # [M, order, 6], newest first
    out[:, :, 3:] = out[:, :, 3:] @ so3.matrices(rotations[order:])  # row vectors: by the inverse of each rotation
    return out.reshape(count, 6 * order)


def displacements(rotations: F64, positions: F64, first: int, steps: int) -> F64:
    """[M, 6] true displacement over ``steps`` from each point from ``first`` on, in that point's camera axes."""
    start, end = slice(first, len(rotations) - steps), slice(first + steps, None)
    inverse = so3.conjugate(rotations[start])
    turned = so3.log(so3.multiply(inverse, rotations[end]))
    return np.concatenate([turned, so3.rotate(inverse, positions[end] - positions[start])], axis=1)


@dataclass(frozen=True, eq=False)
class PooledWeights:
    """Matrices [H, 6 x order, 6] by order, for ``HORIZON_STEPS``, and where they came from."""

    matrices: dict[int, F64]
    provenance: dict[str, Any]

    def order_for(self, increments: int) -> int:
        """The longest window that so many increments fill; 0 if none."""
        return max((order for order in self.matrices if order <= increments), default=0)

    def at(self, order: int, steps: float) -> F64:
        """[6 x order, 6] for a horizon of ``steps`` grid steps, at most the longest fitted one."""
        grid = np.array((0, *HORIZON_STEPS), dtype=np.float64)
        above = int(np.clip(np.searchsorted(grid, steps), 1, len(grid) - 1))
        share = min(max((steps - grid[above - 1]) / (grid[above] - grid[above - 1]), 0.0), 1.0)
        fitted = self.matrices[order]
        below = fitted[above - 2] if above > 1 else np.zeros_like(fitted[0])
        return np.asarray(below + share * (fitted[above - 1] - below))

    def save(self, path: Path) -> None:
        """Write an ``.npz`` of float32 arrays and a JSON text."""
        text = np.frombuffer(json.dumps(self.provenance, sort_keys=True).encode(), np.uint8)
        arrays = {f"order_{order}": matrix.astype(np.float32) for order, matrix in self.matrices.items()}
        with whole_file(path) as writing, writing.open("wb") as file:
            np.savez(file, provenance=text, **arrays)  # type: ignore[arg-type]

    @staticmethod
    @cache
    def shipped() -> PooledWeights:
        """The shipped weights, read once and shared by all viewers."""
        return PooledWeights.load()

    @staticmethod
    def load(path: Path = SHIPPED) -> PooledWeights:
        """Read what :meth:`save` wrote. Raises :class:`ConfigError` for anything else."""
        try:
            file = load_npz(path, MAX_WEIGHTS_BYTES)
            provenance = json.loads(file["provenance"].tobytes())
            matrices = {order: file[f"order_{order}"].astype(np.float64) for order in ORDERS}
        except (OSError, DecodeError, ValueError, KeyError) as error:
            raise ConfigError(f"{path}: cannot be read as predictor weights ({error})") from error
        for order, matrix in matrices.items():
            if matrix.shape != (len(HORIZON_STEPS), 6 * order, 6) or not np.isfinite(matrix).all():
                raise ConfigError(f"{path}: weights of order {order} have shape {matrix.shape} or are not finite")
        return PooledWeights(matrices, provenance)
