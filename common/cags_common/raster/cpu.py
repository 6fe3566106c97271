"""The ``cpu`` backend: the native kernels of ``cags-kernels`` behind the rasteriser seam."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

import cags_kernels
from cags_common.errors import CagsError, ConfigError
from cags_common.geometry import F32, Camera
from cags_common.raster.base import DepthKind, Exactness, RasterScene, RenderedView, RenderOptions
from cags_common.raster.checks import change, check_camera, drawable
from cags_common.runtime.threads import threads_for_rows
from cags_common.splats import Splats

if TYPE_CHECKING:
    from cags_kernels.raster import RasterCamera, RasterOptions


@dataclass(frozen=True, slots=True)
class ErrorBound:
    """How far a level may be from the reference, as a share of the brightest colour (of 1 where none is brighter)."""

    usual: float
    """For 99 % of the pixels."""
    largest: float
    """For all: at a splat's rim rounding decides whether a last alpha of 1 / 255 is drawn."""


BOUNDS = {
    Exactness.FAST: ErrorBound(usual=6e-3, largest=0.02),
    Exactness.BALANCED: ErrorBound(usual=1e-3, largest=0.01),
    Exactness.EXACT: ErrorBound(usual=1e-5, largest=0.004),
}
"""The levels' bounds; docs/rasteriser.md tells what each level gives up."""

_Take = Callable[[NDArray[np.int64], tuple[F32, ...], int], None]

_EXACTNESS = {Exactness.FAST: 0, Exactness.BALANCED: 1, Exactness.EXACT: 2}
_DEPTH = {DepthKind.NONE: 0, DepthKind.EXPECTED: 1}


class CpuRasteriser:
    """The backend called ``cpu``. Raises :class:`ConfigError` where the native library is missing."""

    name = "cpu"

    def __init__(self) -> None:
        if not cags_kernels.native_available():
            reason = cags_kernels.why_unavailable()
            raise ConfigError(f"rasteriser 'cpu' cannot run: {reason}; install a C++ compiler, then ./kernels again")

    def load(self, splats: Splats) -> RasterScene:
        """Take a copy of ``splats``. Raises :class:`cags_common.errors.SceneError` for values that cannot be drawn."""
        return CpuScene(drawable(splats))


class CpuScene:
    """Splats held by the native library, in the layout that it draws from."""

    def __init__(self, splats: Splats) -> None:
        from cags_kernels.raster import NativeScene

        self._native = NativeScene(_arrays(splats), threads=2)
        self._harmonics = splats.sh_rest.shape[1]

    def __len__(self) -> int:
        return self._native.count

    def update(self, rows: NDArray[np.integer], splats: Splats, threads: int = 1) -> None:
        """Take the splats at ``rows`` [M] from ``splats``, those of the whole scene."""
        self._change(self._native.update, rows, splats, threads)

    def move(self, rows: NDArray[np.integer], splats: Splats, threads: int = 1) -> None:
        """Take position, rotation and opacity at ``rows`` [M] from ``splats``, those of the whole scene."""
        self._change(self._native.move, rows, splats, threads)

    def _change(self, take: _Take, rows: NDArray[np.integer], splats: Splats, threads: int) -> None:
        indices, logits = change(rows, splats, (len(self), self._harmonics))
        try:
            take(indices, _arrays(replace(splats, logit_opacities=logits)), threads_for_rows(len(indices), threads))
        except cags_kernels.KernelError:
            drawable(splats.take(indices))  # says what is wrong with them
            raise

    def render(self, camera: Camera, options: RenderOptions) -> RenderedView:
        """Render one view over black."""
        check_camera(camera)
        try:
            image = self._native.render(_camera(camera), _options(options), contribution=options.contribution)
        except cags_kernels.KernelError as error:
            raise CagsError(f"rendering {camera.width_px}x{camera.height_px} px failed: {error}") from error
        return RenderedView(image.rgb, image.alpha, image.depth, image.contribution)


def _arrays(splats: Splats) -> tuple[F32, ...]:
    return tuple(array for _, array in splats.arrays())


def _camera(camera: Camera) -> RasterCamera:
    from cags_kernels.raster import RasterCamera

    i = camera.intrinsics
    rotation, position = camera.world_to_camera[0], np.asarray(camera.pose.position)
    return RasterCamera(rotation, position, i.fx_px, i.fy_px, i.cx_px, i.cy_px, camera.near, i.width_px, i.height_px)


def _options(options: RenderOptions) -> RasterOptions:
    from cags_kernels.raster import BRIGHTEST, RasterOptions

    return RasterOptions(
        dilation=options.footprint.dilation_px2,
        filter=options.footprint.filter_px2,
        void_alpha=options.void_alpha,
        exactness=_EXACTNESS[options.exactness],
        depth=_DEPTH[options.depth],
        max_sh_degree=options.max_sh_degree,
        threads=options.threads,
        brightest=1.0 if options.displayed else BRIGHTEST,
    )
