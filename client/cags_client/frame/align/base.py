"""The alignment seam: a reference picture of another pose, brought to the client's view by the client's own depth.

Pixel (i, j) has its centre at (i + 0.5, j + 0.5) in both views, so an identity alignment of equal sizes returns the
reference. Coordinates ``x, y`` below are continuous reference pixels in that sense.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cags_client.store.picture import ReferencePicture
from cags_common.correction import Placement
from cags_common.geometry import F32, F64, Camera
from cags_common.settings import check_settings, parameter


@dataclass(frozen=True)
class AlignSettings:
    """How occlusion is told and how it is repaired."""

    depth_tolerance: float = parameter(
        0.03, "a pixel is occluded where it lies this share of the depth behind what the reference shows", low=0, high=1
    )
    slope_cells: float = parameter(
        1.0, "depth change over this many reference pixels of the surface's own slope is no occlusion", low=0, high=8
    )
    border_px: float = parameter(
        3.0, "confidence falls to zero over this many reference pixels before the border", low=0, high=64
    )
    erosion_radius_px: int = parameter(
        2, "occluded pixels take the mean of clean ones within this radius (client pixels)", low=0, high=16
    )
    erosion_iterations: int = parameter(
        8, "how many times occluded pixels are filled from their clean neighbours; 0 turns erosion off", low=0, high=64
    )

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, eq=False)
class Reprojection:
    """How a client's picture lies in a reference: the client's depth and both cameras.

    Client pixel (u, v) of depth D lies at ``m [u, v, 1] D + b`` in the reference, homogeneous: ``(x z, y z, z)`` in
    reference pixels and reference camera-space depth. This is line 1 of the pseudocode with its errata settled:
    ``x_w = R_l K_l^-1 [u, v, 1] D + T_l`` and ``p_r = K_r R_r^-1 (x_w - T_r)``.
    """

    depth: F32  # [H, W] camera-space z; non-finite or <= 0 is void
    camera: Camera
    reference: Camera

    def __post_init__(self) -> None:
        if self.depth.shape != (self.camera.height_px, self.camera.width_px):
            size = f"{self.camera.width_px}x{self.camera.height_px}"
            raise ValueError(f"depth of shape {self.depth.shape} under a camera of {size}")

    @cached_property
    def matrix(self) -> tuple[F64, F64]:
        """m [3, 3] and b [3]."""
        whole = self._placement.matrix
        return whole[:, :3], whole[:, 3]

    @property
    def cell_px(self) -> tuple[float, float]:
        """Client pixels a reference pixel, in angle at the images' centres, along x and y."""
        return self._placement.cell_px

    @property
    def stride(self) -> int:
        """Every how many pixels and rows the client's view is sampled for what hides what: twice a reference pixel."""
        return self._placement.stride

    @cached_property
    def _placement(self) -> Placement:
        return Placement(self.camera, self.reference)

    @cached_property
    def projected(self) -> tuple[F32, F32, F32, NDArray[np.bool_]]:
        """x, y, z [H, W] in the reference, 0 where the pixel is not in it, and where it is."""
        m, b = (a.astype(np.float32) for a in self.matrix)
        u = np.arange(self.camera.width_px, dtype=np.float32)[None] + np.float32(0.5)
        v = np.arange(self.camera.height_px, dtype=np.float32)[:, None] + np.float32(0.5)
        d = self.depth
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            z = d * (m[2, 0] * u + (m[2, 1] * v + m[2, 2])) + b[2]
            x = (d * (m[0, 0] * u + (m[0, 1] * v + m[0, 2])) + b[0]) / z
            y = (d * (m[1, 0] * u + (m[1, 1] * v + m[1, 2])) + b[1]) / z
            inside = (d > 0) & np.isfinite(d) & (z > 0) & np.isfinite(z) & (x >= 0) & (y >= 0)
            inside &= (x <= self.reference.width_px) & (y <= self.reference.height_px)
        zero = np.float32(0)
        return np.where(inside, x, zero), np.where(inside, y, zero), np.where(inside, z, zero), inside


@dataclass(frozen=True, eq=False)
class Aligned:
    """A reference brought to the client's view."""

    paint: Callable[[], F32]
    """Makes :attr:`rgb`; called once."""
    confidence: F32  # [H, W] in [0, 1]: 0 for void, behind, outside or occluded; fades towards the reference's border
    occluded: NDArray[np.bool_]  # [H, W] seen by the client, hidden from the reference
    geometry: Reprojection
    """Where the client's pixels lie in the reference."""

    @cached_property
    def rgb(self) -> F32:
        """[H, W, 3] in [0, 1]; black where the reference says nothing and no clean neighbour is near.

        Made when first looked at, unless the aligner was asked for it at once.
        """
        return self.paint()


class Aligner(Protocol):
    """Post-render perspective alignment (paper section PRPA; supplement, pseudocode, with its errata settled)."""

    @property
    def name(self) -> str:
        """Name in the registry."""
        ...

    def align(
        self,
        reference: ReferencePicture,
        depth: F32,
        camera: Camera,
        *,
        occlusion: bool = True,
        colours: bool = False,
    ) -> Aligned:
        """Align ``reference`` to ``camera`` by its depth [H, W] (camera-space z; non-finite or <= 0 is void).

        Without ``occlusion`` every pixel counts as seen: for cameras at one place, where nothing can be hidden.
        With ``colours`` they are made at once, as a part of the alignment's time, else when they are first looked at.
        Raises ``ValueError`` where ``depth`` does not have the camera's size.
        """
        ...
