"""The correction seam: from a client's view and a reference to the displayed frame.

A :class:`Corrector` samples the reference's correction by the client's own depth and adds it to the view (PRPA,
post-render perspective alignment, as the last step of a frame). Implementations: ``oracle`` (float64, the readable
definition: :mod:`.oracle`), ``cpu`` (``cags-kernels``: :mod:`.cpu`). :mod:`cags_gpu` does the same in shaders,
together with drawing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from cags_common.geometry import F32, F64, Camera
from cags_common.raster.base import RenderedView
from cags_common.settings import check_settings, parameter

CELL_PX = 8
"""Side of the cells whose mean depth fills holes."""

VETO_CELL_PX = 16
"""Side of the cells of a veto."""

LEAST_AROUND_PX = 1.0
"""Number of confident pixels at which a cell has full weight for the hidden pixels around it."""

FAR = 1e6
"""Largest depth, world units, and the depth of a view without any. Depths below 1 / FAR are unknown."""


LEAST_KNEE, LARGEST_KNEE = 1e-3, 10.0
"""Range of the compander's knee; outside of it the curve degenerates to a staircase or a line."""


@dataclass(frozen=True)
class CorrectSettings:
    """Settings of the transfer of corrections to the client's view."""

    depth_tolerance: float = parameter(
        0.03, "a pixel is hidden where it lies this share of the depth behind what the reference shows", low=0, high=1
    )
    slope_cells: float = parameter(
        1.0, "depth change over this many reference pixels of the surface's own slope hides nothing", low=0, high=8
    )
    border_px: float = parameter(16.0, "corrections fade over this many pixels beyond the reference", low=0, high=64)
    hole_alpha: float = parameter(0.3, "pixels of less opacity take their depth from around them", low=0, high=1)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, eq=False)
class Reference:
    """A decoded reference. It must not be changed, because correctors cache results for it."""

    coded: F32  # [h, w, 3] in [0, 1]
    camera: Camera
    picture: bool = False
    """Whether it is a picture, which the client compares with its own render, and not a companded difference."""
    knee: float = 0.1
    """Knee of the compander: smaller differences are coded approximately linearly."""
    error: float = 0.0
    """Mean squared coding error of a picture, RGB in [0, 1]; see :func:`.trust.layer`."""

    def __post_init__(self) -> None:
        size = self.camera.height_px, self.camera.width_px, 3
        if self.coded.shape != size:
            raise ValueError(f"reference of shape {self.coded.shape} under a camera of {size[1]}x{size[0]}")
        if not LEAST_KNEE <= self.knee <= LARGEST_KNEE:
            limits = f"[{LEAST_KNEE}, {LARGEST_KNEE}]"
            raise ValueError(f"knee = {self.knee} must lie in {limits}; 0.05 to 0.15 suit")
        if not 0 <= self.error <= 1:
            raise ValueError(f"error = {self.error} must lie in [0, 1]: a mean square of colours in [0, 1]")


@dataclass(frozen=True, eq=False)
class Corrected:
    """A frame for display."""

    rgb: F32  # [H, W, 3] in [0, 1]
    confidence: F32  # [H, W] in [0, 1]: share of the reference's correction that was added


class Corrector(Protocol):
    """Corrects frames; intermediate results for a reference are cached while it is used."""

    @property
    def name(self) -> str:
        """Its name for :func:`cags_common.correction.create`."""
        ...

    def needs_own(self, reference: Reference) -> bool:
        """Whether :meth:`correct` needs ``own``, a render from the reference camera of a new picture."""
        ...

    def correct(
        self,
        view: RenderedView,
        camera: Camera,
        reference: Reference,
        own: F32 | None = None,
        settings: CorrectSettings | None = None,
        *,
        veto: F32 | None = None,
    ) -> Corrected:
        """Correct ``view`` (with depth), drawn from ``camera``, by ``reference``.

        ``own`` [h, w, 3] is the client's render from the reference camera. Pictures need it when they are new and when
        splats have changed; otherwise the previous one for this reference is used. ``veto`` in [0, 1], [H, W] or
        [ceil(H / 16), ceil(W / 16)] (cells of 16 x 16 pixels, interpolated linearly between their centres), is the
        share of confidence to remove. Raises ``ValueError`` for wrong shapes, a view without depth and a picture
        without ``own``.
        """
        ...


@dataclass(frozen=True)
class Placement:
    """Projection of client pixels to a reference: ``(x z, y z, z) = D m (u, v, 1) + b`` for pixel (u, v) of depth D."""

    camera: Camera
    reference: Camera

    @cached_property
    def matrix(self) -> F64:
        """m and b [3, 4]."""
        k_client, k_reference = _pinhole(self.camera), _pinhole(self.reference)
        to_reference = k_reference @ self.reference.pose.rotation_matrix.T
        shift = np.asarray(self.camera.pose.position) - np.asarray(self.reference.pose.position)
        m = to_reference @ self.camera.pose.rotation_matrix @ np.linalg.inv(k_client)
        return np.concatenate([m, (to_reference @ shift)[:, None]], axis=1)

    @property
    def cell_px(self) -> tuple[float, float]:
        """Client pixels per reference pixel along x and y, by angle at the images' centres."""
        client, other = self.camera.intrinsics, self.reference.intrinsics
        return client.fx_px / other.fx_px, client.fy_px / other.fy_px

    @property
    def stride(self) -> int:
        """Step, in pixels, at which the client's view is sampled for occlusion: two reference pixels."""
        return max(1, int(min(self.cell_px) / 2))


def checked_depth(view: RenderedView, camera: Camera) -> F32:
    """The depth of ``view``. Raises ``ValueError`` if it is missing or not of the camera's size."""
    if view.depth is None:
        raise ValueError("a view without depth cannot be corrected; draw it with DepthKind.EXPECTED")
    size = camera.height_px, camera.width_px
    if not view.depth.shape == view.alpha.shape == view.rgb.shape[:2] == size:
        raise ValueError(f"a view of {view.depth.shape[1]}x{view.depth.shape[0]} under a camera of {size[1]}x{size[0]}")
    return view.depth


def checked_own(own: F32, reference: Reference) -> F32:
    """Check and return ``own``. Raises ``ValueError`` if it is not of the reference's size."""
    if own.shape != reference.coded.shape:
        raise ValueError(
            f"render from the reference camera: shape {own.shape}, but the reference has {reference.coded.shape}"
        )
    return own


def veto_shape(camera: Camera) -> tuple[int, int]:
    """Rows and columns of a coarse veto for the views of ``camera``."""
    return -(-camera.height_px // VETO_CELL_PX), -(-camera.width_px // VETO_CELL_PX)


def checked_veto(veto: F32, camera: Camera) -> F32:
    """Check and return ``veto``. Raises ``ValueError`` for a size other than the two allowed ones."""
    sizes = (camera.height_px, camera.width_px), veto_shape(camera)
    if veto.shape not in sizes:
        raise ValueError(f"a veto of shape {veto.shape} for a view of {sizes[0]}: either that or {sizes[1]}")
    return veto


def _pinhole(camera: Camera) -> F64:
    i = camera.intrinsics
    return np.array([[i.fx_px, 0.0, i.cx_px], [0.0, i.fy_px, i.cy_px], [0.0, 0.0, 1.0]])
