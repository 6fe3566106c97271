"""The ``cuda`` backend: gsplat (Ye et al. 2024) behind the rasteriser seam.

Imported and compiled at first use only. It follows gsplat where that differs from the reference: alpha is capped at
0.999 instead of 0.99, and a pixel is given up at a transmittance of 1e-4, whatever the level of exactness.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cags_common.errors import ConfigError
from cags_common.geometry import F32, Camera
from cags_common.raster.base import BackProjection, DepthKind, Footprint, RasterScene, RenderedView, RenderOptions
from cags_common.raster.checks import check_camera, check_residual, drawable, movement, recolouring, replacements
from cags_common.raster.definition import MAX_DEPTH
from cags_common.splats import SH_REST_OF_DEGREE, Splats

Tensor: TypeAlias = Any  # torch.Tensor, without importing torch here

TILE_PX = 16


@cache
def why_unavailable() -> str:
    """Why the ``cuda`` backend cannot be used here; empty when it can. The first call may compile gsplat's kernels."""
    import torch

    if not torch.cuda.is_available():
        return "torch sees no CUDA device"
    try:
        from gsplat.cuda import _backend
    except ImportError as error:
        return f"gsplat does not import ({error}); pip install 'cags-stream[cuda]'"
    if getattr(_backend, "_C", None) is None:
        return "gsplat could not compile its CUDA kernels; it needs the CUDA toolkit's nvcc"
    return ""


class CudaRasteriser:
    """The backend called ``cuda``. Raises :class:`ConfigError` with the reason where it cannot be used."""

    name = "cuda"

    def __init__(self) -> None:
        reason = why_unavailable()
        if reason:
            raise ConfigError(f"rasteriser 'cuda' cannot run: {reason}; use 'cpu'")

    def load(self, splats: Splats) -> RasterScene:
        """Take a copy of ``splats`` to the device. Raises :class:`SceneError` for values that cannot be drawn."""
        import gsplat

        return CudaScene(drawable(splats), gsplat, "cuda")


@dataclass(frozen=True, eq=False)
class _Projection:
    """Splats as gsplat sees them, a batch of one view."""

    centres: Tensor  # [1, N, 2] pixels
    conics: Tensor  # [1, N, 3]
    opacities: Tensor  # [1, N] compensated for the footprint's filter
    depths: Tensor  # [1, N]
    tiles: Tensor  # [1, tile rows, tile columns] offsets
    order: Tensor  # [entries]


class CudaScene:
    """Splats on the device. ``library`` is gsplat, or what offers its functions."""

    def __init__(self, splats: Splats, library: Any, device: str) -> None:
        self._library, self._device = library, device
        self._columns = {name: self._tensor(array) for name, array in splats.arrays()}

    def __len__(self) -> int:
        return len(self._columns["means"])

    def update(self, rows: NDArray[np.integer], splats: Splats) -> None:
        """Replace the splats at ``rows`` [M]."""
        new, indices = replacements(rows, splats, len(self), self._columns["sh_rest"].shape[1])
        at = self._tensor(indices)
        for name, array in new.arrays():
            self._columns[name][at] = self._tensor(array)

    def move(self, rows: NDArray[np.integer], splats: Splats, threads: int = 1) -> None:
        """Take position, rotation and opacity at ``rows`` [M] from ``splats``, those of the whole scene."""
        indices, _ = movement(rows, splats, len(self))
        new, at = drawable(splats.take(indices)), self._tensor(indices)
        for name in ("means", "quats", "logit_opacities"):
            self._columns[name][at] = self._tensor(getattr(new, name))

    def recolour(self, rows: NDArray[np.integer], sh0: F32) -> None:
        """Replace only the base colours ``sh0`` [M, 3] of the splats at ``rows`` [M]."""
        indices, colours = recolouring(rows, sh0, len(self))
        self._columns["sh0"][self._tensor(indices)] = self._tensor(colours)

    def render(self, camera: Camera, options: RenderOptions) -> RenderedView:
        """Render one view over black. Raises :class:`ConfigError` for the median depth, which gsplat does not give."""
        import torch

        check_camera(camera)
        if options.depth is DepthKind.MEDIAN:
            raise ConfigError("depth = median is not offered by the rasteriser 'cuda'; use expected, or 'cpu'")
        if not len(self):
            return _empty_view(camera, options)
        with torch.set_grad_enabled(options.contribution):
            projection = self._project(camera, options.footprint)
            weights = torch.ones((1, len(self), 1), device=self._device, requires_grad=options.contribution)
            channels = torch.cat([self._colours(camera, options), projection.depths[..., None], weights], dim=-1)
            image, alpha = self._composite(camera, projection, channels)
            contribution = None
            if options.contribution:
                (contribution,) = torch.autograd.grad(image[..., 4].sum(), weights)
        rgb, alpha, depth = image[0, ..., :3].detach(), alpha[0, ..., 0].detach(), image[0, ..., 3].detach()
        void = alpha < max(options.void_alpha, 1e-12)
        finished = torch.where(void, torch.inf, depth / torch.where(void, 1.0, alpha))
        return RenderedView(
            _array(rgb.clamp(max=1.0) if options.displayed else rgb),
            _array(alpha),
            None if options.depth is DepthKind.NONE else _array(finished),
            None if contribution is None else _array(contribution[0, :, 0]),
        )

    def back_project(self, camera: Camera, residual: F32, options: RenderOptions) -> BackProjection:
        """Carry ``residual`` [H, W, 3] onto the splats: the gradient of compositing with respect to the colours."""
        import torch

        check_camera(camera)
        image = self._tensor(check_residual(residual, camera))
        if not len(self):
            return BackProjection(np.zeros((0, 3), np.float32), np.zeros(0, np.float32))
        projection = self._project(camera, options.footprint)
        channels = torch.ones((1, len(self), 4), device=self._device, requires_grad=True)
        drawn, _ = self._composite(camera, projection, channels)
        (gradient,) = torch.autograd.grad((drawn[0, ..., :3] * image).sum() + drawn[..., 3].sum(), channels)
        return BackProjection(_array(gradient[0, :, :3]), _array(gradient[0, :, 3]))

    def _tensor(self, array: NDArray[Any]) -> Tensor:
        import torch

        return torch.as_tensor(array, device=self._device).clone()

    def _matrices(self, camera: Camera) -> tuple[Tensor, Tensor]:
        """World-to-camera [1, 4, 4] and intrinsics [1, 3, 3]."""
        rotation, translation = camera.world_to_camera
        view = np.eye(4)
        view[:3, :3], view[:3, 3] = rotation, translation
        i = camera.intrinsics
        pinhole = np.array([[i.fx_px, 0, i.cx_px], [0, i.fy_px, i.cy_px], [0, 0, 1]])
        return self._tensor(view.astype(np.float32)[None]), self._tensor(pinhole.astype(np.float32)[None])

    def _project(self, camera: Camera, footprint: Footprint) -> _Projection:
        view, pinhole = self._matrices(camera)
        width, height = camera.width_px, camera.height_px
        columns = self._columns

        def project(variance: float) -> tuple[Tensor, ...]:
            scales = columns["log_scales"].exp()
            geometry = (columns["means"], None, columns["quats"], scales, view, pinhole, width, height)
            limits = {"near_plane": camera.near, "far_plane": MAX_DEPTH}
            found: tuple[Tensor, ...] = self._library.fully_fused_projection(
                *geometry, eps2d=variance, calc_compensations=True, **limits
            )
            return found

        radii, centres, depths, conics, compensations = project(footprint.dilation_px2 + footprint.filter_px2)
        opacities = columns["logit_opacities"].sigmoid()[None]
        if footprint.filter_px2 > 0:
            narrow = project(footprint.dilation_px2)[3] if footprint.dilation_px2 > 0 else None
            opacities = opacities * _kept(conics, compensations, narrow)
        tiles_x, tiles_y = -(-width // TILE_PX), -(-height // TILE_PX)
        _, keys, order = self._library.isect_tiles(centres, radii, depths, TILE_PX, tiles_x, tiles_y)
        tiles = self._library.isect_offset_encode(keys, 1, tiles_x, tiles_y)
        return _Projection(centres, conics, opacities, depths, tiles.reshape(1, tiles_y, tiles_x), order)

    def _colours(self, camera: Camera, options: RenderOptions) -> Tensor:
        """[1, N, 3], >= 0."""
        import torch

        columns = self._columns
        held = SH_REST_OF_DEGREE.index(columns["sh_rest"].shape[1])
        coefficients = torch.cat([columns["sh0"][:, None], columns["sh_rest"]], dim=1)
        directions = columns["means"] - self._tensor(np.asarray(camera.pose.position, np.float32))
        degree = min(held, options.max_sh_degree)
        colours = self._library.spherical_harmonics(degree, directions, coefficients)
        return (colours + 0.5).clamp_min(0.0)[None]

    def _composite(self, camera: Camera, projection: _Projection, channels: Tensor) -> tuple[Tensor, Tensor]:
        """Image [1, H, W, C] of ``channels`` [1, N, C], and alpha [1, H, W, 1]."""
        image, alpha = self._library.rasterize_to_pixels(
            *(projection.centres, projection.conics, channels, projection.opacities),
            *(camera.width_px, camera.height_px, TILE_PX, projection.tiles, projection.order),
        )
        return image, alpha


def _kept(conics: Tensor, compensations: Tensor, narrow: Tensor | None) -> Tensor:
    """Factor [1, N] on the opacities: sqrt(det(S + dilation) / det(S + dilation + filter)).

    gsplat's ``compensations`` are sqrt(det(S) / det(S + dilation + filter)): right without dilation (``narrow`` None).
    """
    import torch

    if narrow is None:
        return compensations
    determinants = [c[..., 0] * c[..., 2] - c[..., 1] ** 2 for c in (conics, narrow)]  # of the inverses
    seen = (determinants[0] > 0) & (determinants[1] > 0)
    ratio = determinants[0] / torch.where(seen, determinants[1], 1.0)
    return torch.where(seen, ratio.clamp(0.0, 1.0).sqrt(), 0.0)


def _array(tensor: Tensor) -> F32:
    array: F32 = np.ascontiguousarray(tensor.cpu().numpy(), dtype=np.float32)
    return array


def _empty_view(camera: Camera, options: RenderOptions) -> RenderedView:
    shape = (camera.height_px, camera.width_px)
    depth = None if options.depth is DepthKind.NONE else np.full(shape, np.inf, np.float32)
    contribution = np.zeros(0, np.float32) if options.contribution else None
    return RenderedView(np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32), depth, contribution)
