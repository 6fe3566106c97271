"""The alignment seam: a reference picture of another pose, brought to the client's view by the client's own depth.

Pixel (i, j) has its centre at (i + 0.5, j + 0.5) in both views, so an identity alignment of equal sizes returns the
reference. Coordinates ``x, y`` below are continuous reference pixels in that sense.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32, F64, Camera
from cags_common.settings import check_settings, setting


@dataclass(frozen=True)
class AlignSettings:
    """How occlusion is told and how it is repaired."""

    depth_tolerance: float = setting(
        0.03, "a pixel is occluded where it lies this share of the depth behind what the reference shows", low=0, high=1
    )
    slope_cells: float = setting(
        1.0, "depth change over this many reference pixels of the surface's own slope is no occlusion", low=0, high=8
    )
    border_px: float = setting(
        3.0, "confidence falls to zero over this many reference pixels before the border", low=0, high=64
    )
    erosion_radius_px: int = setting(
        2, "occluded pixels take the mean of clean ones within this radius (client pixels)", low=0, high=16
    )
    erosion_iterations: int = setting(
        8, "how many times occluded pixels are filled from their clean neighbours; 0 turns erosion off", low=0, high=64
    )

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, eq=False)
class ReferencePicture:
    """A decoded reference: what the server saw from ``camera`` at source frame ``frame``."""

    rgb: F32  # [h, w, 3] in [0, 1]
    camera: Camera
    frame: int
    seq: int = 0

    def __post_init__(self) -> None:
        if self.rgb.shape != (self.camera.height_px, self.camera.width_px, 3):
            raise ValueError(
                f"reference of shape {self.rgb.shape} under a camera of {self.camera.width_px}x{self.camera.height_px}"
            )


@dataclass(frozen=True, eq=False)
class Aligned:
    """A reference brought to the client's view."""

    rgb: F32  # [H, W, 3] in [0, 1]; black where the reference says nothing and no clean neighbour is near
    confidence: F32  # [H, W] in [0, 1]: 0 for void, behind, outside or occluded; fades towards the reference's border
    occluded: NDArray[np.bool_]  # [H, W] seen by the client, hidden from the reference
    x: F32  # [H, W] where the pixel lies in the reference; finite everywhere, meaningful where confidence > 0
    y: F32  # [H, W]


class Aligner(Protocol):
    """Post-render perspective alignment (paper section PRPA; supplement, pseudocode, with its errata settled)."""

    @property
    def name(self) -> str:
        """Name in the registry."""
        ...

    def align(self, reference: ReferencePicture, depth: F32, camera: Camera) -> Aligned:
        """Align ``reference`` to ``camera`` by its depth [H, W] (camera-space z; non-finite or <= 0 is void).

        Raises ``ValueError`` where ``depth`` does not have the camera's size.
        """
        ...


def reprojection(camera: Camera, reference: Camera) -> tuple[F64, F64]:
    """Matrix M [3, 3] and vector b [3]: client pixel (u, v) of depth D lies at ``M [u, v, 1] D + b`` in the reference.

    The result is homogeneous: ``(x z, y z, z)`` in reference pixels and reference camera-space depth. This is line 1 of
    the pseudocode with its errata settled: ``x_w = R_l K_l^-1 [u, v, 1] D + T_l`` and ``p_r = K_r R_r^-1 (x_w - T_r)``.
    """
    k_l, k_r = _matrix(camera), _matrix(reference)
    rotation_l, rotation_r = camera.pose.rotation_matrix, reference.pose.rotation_matrix
    to_reference = k_r @ rotation_r.T
    shift = np.asarray(camera.pose.position) - np.asarray(reference.pose.position)
    m: F64 = to_reference @ rotation_l @ np.linalg.inv(k_l)
    b: F64 = to_reference @ shift
    return m, b


def cell_size(camera: Camera, reference: Camera) -> tuple[float, float]:
    """Client pixels a reference pixel, in angle at the images' centres, along x and y."""
    client, other = camera.intrinsics, reference.intrinsics
    return client.fx_px / other.fx_px, client.fy_px / other.fy_px


def _matrix(camera: Camera) -> F64:
    i = camera.intrinsics
    return np.array([[i.fx_px, 0.0, i.cx_px], [0.0, i.fy_px, i.cy_px], [0.0, 0.0, 1.0]])
