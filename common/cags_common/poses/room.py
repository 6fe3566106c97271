"""A box-shaped room around a walk: depth for walks that were recorded without their scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cags_common.geometry import F64

HALF_SIZE_M = 2.5
"""Least distance from the middle of the walk to each wall."""

CLEARANCE_M = 0.6
"""Least distance from any position of the walk to each wall."""


@dataclass(frozen=True, eq=False)
class Room:
    """An axis-aligned box; the viewer is inside."""

    low: F64  # [3] world
    high: F64  # [3] world

    @classmethod
    def around(cls, positions: F64) -> Room:
        """The room of a walk [N, 3]."""
        centre = positions.mean(axis=0)
        low = np.minimum(centre - HALF_SIZE_M, positions.min(axis=0) - CLEARANCE_M)
        return cls(low, np.maximum(centre + HALF_SIZE_M, positions.max(axis=0) + CLEARANCE_M))

    def points(self, position: F64, rotation: F64, rays: F64) -> F64:
        """[R, 3] where ``rays`` [R, 3] (camera axes, z = 1) of a camera at ``position`` [3], ``rotation`` [3, 3] end.

        In camera axes.
        """
        directions = rays @ rotation.T
        with np.errstate(divide="ignore"):
            walls = np.where(directions > 0, self.high - position, self.low - position) / directions
        distance = np.where(np.isfinite(walls), walls, np.inf).min(axis=1)
        return np.asarray(rays * distance[:, None])
