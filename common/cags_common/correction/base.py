"""The correction seam: a client's view and what a server says is lacking in, the frame to show out.

A :class:`Corrector` brings what is lacking from the reference's camera to the client's by the client's own depth and
adds it (PRPA, post-render perspective alignment, as the last step of a frame). Implementations: ``reference`` (float64,
readable, the definition of right: :mod:`.oracle`), ``cpu`` (``cags-kernels``: :mod:`.cpu`). :mod:`cags_gpu` does the
same by shaders, together with the drawing.
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
"""Confident pixels of a cell: what is fewer says less of the hidden pixels around."""

FAR = 1e6
"""Depth where nothing is known anywhere, and the largest that counts, world units. Depths below 1 / FAR are unknown."""


LEAST_KNEE, LARGEST_KNEE = 1e-3, 10.0
"""Of the compander: beyond it is a staircase or a straight line."""


@dataclass(frozen=True)
class CorrectSettings:
    """How what is lacking is brought to the client's view."""

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
    """What a server sent of a view, decoded. Not changed afterwards: correctors keep what they made of it."""

    coded: F32  # [h, w, 3] in [0, 1]
    camera: Camera
    picture: bool = False
    """A picture of the scene, which the client compares with its own render; else a companded difference."""
    knee: float = 0.1
    """Differences below it are coded about linearly."""
    error: float = 0.0
    """Mean squared error that coding has left in a picture, [0, 1] RGB; see :func:`.trust.layer`."""

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
    """A frame to show."""

    rgb: F32  # [H, W, 3] in [0, 1]
    confidence: F32  # [H, W] in [0, 1]: how much of what the reference says was added


class Corrector(Protocol):
    """Corrects frame after frame; what it makes of a reference is kept while that reference is used."""

    @property
    def name(self) -> str:
        """What :func:`cags_common.correction.create` calls it."""
        ...

    def needs_own(self, reference: Reference) -> bool:
        """Whether :meth:`correct` needs ``own``: a render from the camera of a picture not yet seen."""
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
        """The frame of ``view`` (with its depth), drawn from ``camera``, with what ``reference`` says is lacking.

        ``own`` [h, w, 3] is the client's view from the reference camera, which pictures need: when one comes first, and
        again when splats changed; without it the one given before with this reference still counts. ``veto`` in [0, 1],
        [H, W] or [ceil(H / 16), ceil(W / 16)] (one value a cell of 16 x 16 pixels, linear between their centres), says
        how much of the confidence is taken away. Raises ``ValueError`` for shapes that do not fit, a view without depth
        and a picture without ``own``.
        """
        ...


@dataclass(frozen=True)
class Placement:
    """How a client's pixels lie in a reference: ``(x z, y z, z) = D m (u, v, 1) + b`` for pixel (u, v) of depth D."""

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
        """Client pixels a reference pixel along x and y, in angle at the images' centres."""
        client, other = self.camera.intrinsics, self.reference.intrinsics
        return client.fx_px / other.fx_px, client.fy_px / other.fy_px

    @property
    def stride(self) -> int:
        """Every how many pixels the client's view is sampled for what hides what: twice a reference pixel."""
        return max(1, int(min(self.cell_px) / 2))


def checked_depth(view: RenderedView, camera: Camera) -> F32:
    """The depth of ``view``. Raises ``ValueError`` where it has none or is not of the camera's size."""
    if view.depth is None:
        raise ValueError("a view without depth cannot be corrected; draw it with DepthKind.EXPECTED")
    size = camera.height_px, camera.width_px
    if not view.depth.shape == view.alpha.shape == view.rgb.shape[:2] == size:
        raise ValueError(f"a view of {view.depth.shape[1]}x{view.depth.shape[0]} under a camera of {size[1]}x{size[0]}")
    return view.depth


def checked_own(own: F32, reference: Reference) -> F32:
    """``own``. Raises ``ValueError`` where it is not of the reference's size."""
    if own.shape != reference.coded.shape:
        raise ValueError(
            f"render from the reference camera: shape {own.shape}, but the reference has {reference.coded.shape}"
        )
    return own


def veto_shape(camera: Camera) -> tuple[int, int]:
    """Rows and columns of a coarse veto for the views of ``camera``."""
    return -(-camera.height_px // VETO_CELL_PX), -(-camera.width_px // VETO_CELL_PX)


def checked_veto(veto: F32, camera: Camera) -> F32:
    """``veto``. Raises ``ValueError`` where it is of neither size that it may have."""
    sizes = (camera.height_px, camera.width_px), veto_shape(camera)
    if veto.shape not in sizes:
        raise ValueError(f"a veto of shape {veto.shape} for a view of {sizes[0]}: either that or {sizes[1]}")
    return veto


def _pinhole(camera: Camera) -> F64:
    i = camera.intrinsics
    return np.array([[i.fx_px, 0.0, i.cx_px], [0.0, i.fy_px, i.cy_px], [0.0, 0.0, 1.0]])
