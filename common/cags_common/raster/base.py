"""The rasteriser seam.

A :class:`Rasteriser` loads splats into a :class:`RasterScene` that lives on the renderer's side between frames; the
scene is updated in part and rendered from any camera. Implementations: ``oracle`` (float64, readable, the definition
of right), ``cpu`` (``cags-kernels``), ``gpu`` (WGSL shaders, :mod:`cags_gpu`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32, Camera, Intrinsics
from cags_common.splats import Splats

DILATION_PX2 = 0.3
"""Variance that 3DGS adds to every projected splat, in squared pixels (Kerbl et al. 2023)."""

MIN_VARIANCE_PX2 = 1e-4
"""Least variance of a footprint: a splat seen edge on must not vanish between pixel centres."""

BOX_VARIANCE_PX2 = 1.0 / 12.0
"""Variance of a pixel-wide box: the low-pass of the pixel itself (Yu et al. 2024, Mip-Splatting)."""


@dataclass(frozen=True, slots=True)
class Footprint:
    """How a splat's projected covariance S (squared pixels) is widened before it is drawn.

    The drawn covariance is ``S + (dilation_px2 + filter_px2) I``; the opacity is multiplied by
    ``sqrt(det(S + dilation_px2 I) / det(S + (dilation_px2 + filter_px2) I))``, so that the filter keeps its weight.
    """

    dilation_px2: float = DILATION_PX2
    filter_px2: float = 0.0

    def __post_init__(self) -> None:
        total = self.dilation_px2 + self.filter_px2
        if not (self.dilation_px2 >= 0 and self.filter_px2 >= 0 and MIN_VARIANCE_PX2 <= total < math.inf):
            raise ValueError(
                f"footprint of {self.dilation_px2} + {self.filter_px2} px^2: both must be >= 0 and finite, "
                f"and their sum at least {MIN_VARIANCE_PX2}"
            )

    @classmethod
    def classic(cls) -> Footprint:
        """As the 3DGS papers draw: 0.3 squared pixels at the image's own pixels, uncompensated."""
        return cls()

    def at_half_resolution(self) -> Footprint:
        """The footprint of an image of half the pixels a side that is brought up again.

        Half a pixel's box: without any, splats between two pixel centres flicker; the whole box blurs once too often.
        """
        return Footprint(self.dilation_px2 / 4, self.filter_px2 / 4 + BOX_VARIANCE_PX2 / 2)

    @classmethod
    def of(cls, client: Intrinsics, reference: Intrinsics) -> Footprint:
        """The client's picture, seen at the reference's resolution: its dilation, then the reference pixel's box.

        The scale is client pixels a reference pixel in angle, at the image's centre, and so includes a widened field
        of view. A plain low-resolution render would draw every splat fatter than the client sees it.
        """
        scale_squared = (client.fx_px / reference.fx_px) * (client.fy_px / reference.fy_px)
        if scale_squared <= 1.0:
            return cls.classic()
        return cls(DILATION_PX2 / scale_squared, BOX_VARIANCE_PX2)


class Exactness(StrEnum):
    """How exact a backend must be; each backend documents what a level gives up."""

    FAST = "fast"
    BALANCED = "balanced"
    EXACT = "exact"


class DepthKind(StrEnum):
    """What the depth image holds."""

    NONE = "none"
    EXPECTED = "expected"
    """Front-to-back alpha-weighted camera-space z, divided by alpha."""


@dataclass(frozen=True, slots=True)
class RenderOptions:
    """What to render, and how exactly."""

    footprint: Footprint = Footprint()
    exactness: Exactness = Exactness.BALANCED
    depth: DepthKind = DepthKind.EXPECTED
    contribution: bool = False
    """Whether to sum each splat's compositing weights over the image."""
    void_alpha: float = 0.05
    """Pixels of less alpha are void: their depth is +inf."""
    max_sh_degree: int = 3
    threads: int = 2
    displayed: bool = False
    """Whether colours end at 1, as a display shows them."""

    def __post_init__(self) -> None:
        if not 0 <= self.void_alpha <= 1:
            raise ValueError(f"void_alpha = {self.void_alpha} must lie in [0, 1]")
        if self.max_sh_degree not in range(4):
            raise ValueError(f"max_sh_degree = {self.max_sh_degree} must lie in 0..3")
        if self.threads < 1:
            raise ValueError(f"threads = {self.threads} must be at least 1")


@dataclass(frozen=True, eq=False)
class RenderedView:
    """One rendered view over a black background."""

    rgb: F32  # [H, W, 3] in [0, inf): premultiplied, display-referred; up to 1 where ``displayed``
    alpha: F32  # [H, W] in [0, 1]
    depth: F32 | None  # [H, W] camera-space z, world units; +inf where void. None for DepthKind.NONE
    contribution: F32 | None  # [N] sum over pixels of the splat's compositing weight, in pixels


class RasterScene(Protocol):
    """Splats held by a renderer. Not thread-safe for updates; concurrent renders are allowed."""

    def __len__(self) -> int: ...

    def update(self, rows: NDArray[np.integer], splats: Splats, threads: int = 1) -> None:
        """Take the splats at ``rows`` [M] from ``splats``, those of the whole scene; the cost is proportional to M.

        Raises ``ValueError`` for ``splats`` that are not as many as the scene's or of another SH degree, ``IndexError``
        for rows beyond, and :class:`cags_common.errors.SceneError` for what cannot be drawn; nothing changes then.
        """
        ...

    def move(self, rows: NDArray[np.integer], splats: Splats, threads: int = 1) -> None:
        """The same of position, rotation and opacity alone, for a fraction of the cost.

        The other attributes must be those that the scene was given.
        """
        ...

    def render(self, camera: Camera, options: RenderOptions) -> RenderedView:
        """Render one view. The result does not depend on ``options.threads``."""
        ...


class Rasteriser(Protocol):
    """A rendering backend."""

    @property
    def name(self) -> str:
        """What :func:`cags_common.raster.create` calls it."""
        ...

    def load(self, splats: Splats) -> RasterScene:
        """Take a copy of ``splats`` (zero splats are legal: every view is black and void)."""
        ...
