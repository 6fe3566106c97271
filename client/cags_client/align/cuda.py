"""Alignment in torch: for clients with a graphics card, where the paper's own figures were taken.

The same definition as :class:`~cags_client.align.reference.ReferenceAligner` in float32, written without a step that
makes the host wait for the device. It runs on the CPU too, where the kernels are ten times faster.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cags_client.align.base import Aligned, AlignSettings, ReferencePicture, Reprojection
from cags_common.errors import ConfigError
from cags_common.geometry import F32, Camera

if TYPE_CHECKING:
    from torch import Tensor

NOBODY = 0x7F800000 << 32
"""Key of a cell in which no pixel lies: an infinite depth."""

INDEX_BITS = 0xFFFFFFFF


class CudaAligner:
    """See the module's text. Raises :class:`ConfigError` where there is no such device."""

    name = "cuda"

    def __init__(self, settings: AlignSettings | None = None, device: str = "cuda") -> None:
        import torch

        if device.startswith("cuda") and not torch.cuda.is_available():
            raise ConfigError("aligner 'cuda' needs a CUDA device and a CUDA build of torch; use 'auto'")
        self._settings, self._device = settings or AlignSettings(), device

    def align(
        self,
        reference: ReferencePicture,
        depth: F32,
        camera: Camera,
        *,
        occlusion: bool = True,
        colours: bool = False,
    ) -> Aligned:
        """See :class:`cags_client.align.base.Aligner`."""
        geometry = Reprojection(depth, camera, reference.camera)
        found = reproject(self.on_device(depth), geometry, self._settings, occlusion=occlusion)

        def paint() -> F32:
            return _array(found.painted(self.on_device(reference.rgb), self._settings))

        painted = paint() if colours else None
        ready: Callable[[], F32] = paint if painted is None else (lambda: painted)
        return Aligned(ready, _array(found.confidence), found.occluded.cpu().numpy(), geometry)

    def on_device(self, array: F32) -> Tensor:
        """``array`` as float32 on the aligner's device."""
        import torch

        return torch.as_tensor(np.ascontiguousarray(array, dtype=np.float32), device=self._device)


@dataclass(frozen=True, eq=False)
class OnDevice:
    """Where a client's pixels lie in a reference, on the device. All [H, W]."""

    x: Tensor  # reference pixels, 0 where the pixel is not in the reference
    y: Tensor
    inside: Tensor
    occluded: Tensor
    occluder: Tensor  # shares a reference pixel with an occluded one, and is seen
    confidence: Tensor

    def painted(self, reference: Tensor, settings: AlignSettings) -> Tensor:
        """Colours [H, W, 3] of ``reference`` [h, w, 3], with the occluded pixels filled from clean ones."""
        import torch
        from torch.nn import functional

        h, w = reference.shape[:2]
        grid = torch.stack([self.x * (2 / w) - 1, self.y * (2 / h) - 1], dim=-1)[None]
        image = reference.permute(2, 0, 1)[None]
        sampled = functional.grid_sample(image, grid, mode="bilinear", padding_mode="border", align_corners=False)
        rgb = sampled.clamp(0, 1) * self.inside  # its weights add up to 1 within rounding alone
        clean = self.inside & ~self.occluded & ~self.occluder
        return _eroded(rgb, self.occluded, clean, settings)[0].permute(1, 2, 0)


def reproject(depth: Tensor, geometry: Reprojection, settings: AlignSettings, *, occlusion: bool = True) -> OnDevice:
    """Alignment of a client's ``depth`` [H, W], without colours. Of ``geometry`` only the cameras count."""
    import torch

    x, y, z, inside = _projected(depth, geometry)
    nowhere = torch.zeros_like(inside)
    occluded, occluder = _occlusion(depth, (x, y, z, inside), geometry, settings) if occlusion else (nowhere, nowhere)
    w, h = geometry.reference.width_px, geometry.reference.height_px
    distance = torch.minimum(torch.minimum(x, w - x), torch.minimum(y, h - y))
    confidence = (distance / max(settings.border_px, 1e-6)).clamp(0, 1) * (inside & ~occluded)
    return OnDevice(x, y, inside, occluded, occluder, confidence)


def _projected(d: Tensor, geometry: Reprojection) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """x, y, z in the reference, 0 where the pixel is not in it, and where it is."""
    import torch

    m, b = (a.astype(np.float32).tolist() for a in geometry.matrix)
    height, width = d.shape
    u = torch.arange(width, dtype=torch.float32, device=d.device)[None] + 0.5
    v = torch.arange(height, dtype=torch.float32, device=d.device)[:, None] + 0.5
    x, y, z = (d * (row[0] * u + (row[1] * v + row[2])) + shift for row, shift in zip(m, b, strict=True))
    x, y = x / z, y / z
    inside = (d > 0) & d.isfinite() & (z > 0) & z.isfinite() & (x >= 0) & (y >= 0)
    inside &= (x <= geometry.reference.width_px) & (y <= geometry.reference.height_px)
    zero = torch.zeros((), device=d.device)
    return torch.where(inside, x, zero), torch.where(inside, y, zero), torch.where(inside, z, zero), inside


def _occlusion(
    depth: Tensor, projected: tuple[Tensor, Tensor, Tensor, Tensor], geometry: Reprojection, settings: AlignSettings
) -> tuple[Tensor, Tensor]:
    """Pixels behind the nearest one of their reference pixel, and the ones in front of those.

    Positive floats order as their bits do, so that one minimum gives the nearest pixel and, of equals, the first.
    """
    import torch

    x, y, z, inside = projected
    across = geometry.reference.width_px + 1
    cells = across * (geometry.reference.height_px + 1)
    cell = y.long() * across + x.long()
    index = torch.arange(z.numel(), device=z.device).view(z.shape)
    keys = torch.where(inside, (z.view(torch.int32).long() << 32) | index, NOBODY)
    sampled = np.s_[:: geometry.stride, :: geometry.stride]
    nearest = torch.full((cells,), NOBODY, dtype=torch.int64, device=z.device)
    nearest.scatter_reduce_(0, cell[sampled].flatten(), keys[sampled].flatten(), "amin")
    first = nearest[cell]
    limit = (first >> 32).int().view(torch.float32) * (1 + settings.depth_tolerance) + _slack(depth, geometry, settings)
    occluded = inside & (z > limit) & _away(first & INDEX_BITS, geometry)
    shared = torch.zeros(cells, dtype=torch.int32, device=z.device)
    shared.scatter_reduce_(0, cell.flatten(), occluded.int().flatten(), "amax")
    return occluded, inside & ~occluded & (shared[cell] > 0)


def _away(first: Tensor, geometry: Reprojection) -> Tensor:
    """Whether the pixel ``first`` [H, W] (row-major index) lies further away than one reference pixel."""
    import torch

    height, width = first.shape
    rows = torch.arange(height, device=first.device)[:, None]
    columns = torch.arange(width, device=first.device)[None]
    sx, sy = geometry.cell_px
    return ((columns - first % width).abs() > sx) | ((rows - first // width).abs() > sy)


def _slack(depth: Tensor, geometry: Reprojection, settings: AlignSettings) -> Tensor:
    """Depth by which a surface of the local slope may fall behind within the reference pixels allowed for."""
    known = depth.isfinite() & (depth > 0)
    sx, sy = geometry.cell_px
    along_rows, along_columns = _slope(depth, known), _slope(depth.T, known.T).T
    return settings.slope_cells * (sx * along_rows + sy * along_columns)


def _slope(depth: Tensor, known: Tensor) -> Tensor:
    """Smaller of the depth steps to the neighbours in a row; steps to void pixels and over the edge do not count."""
    import torch
    from torch.nn import functional

    step = (depth[:, 1:] - depth[:, :-1]).abs()
    step = torch.where(known[:, 1:] & known[:, :-1], step, torch.inf)
    left, right = functional.pad(step, (1, 0), value=np.inf), functional.pad(step, (0, 1), value=np.inf)
    smaller = torch.minimum(left, right)
    return torch.where(smaller.isinf(), 0.0, smaller)


def _eroded(rgb: Tensor, occluded: Tensor, clean: Tensor, settings: AlignSettings) -> Tensor:
    """``rgb`` [1, 3, H, W] with holes filled ring by ring; every ring reads only what was there before it."""
    import torch
    from torch.nn import functional

    radius, iterations = settings.erosion_radius_px, settings.erosion_iterations
    if not radius or not iterations:
        return rgb
    state = torch.cat([rgb * clean, clean[None, None].to(rgb.dtype)], dim=1)  # the last channel: what can be used
    side = 2 * radius + 1
    holes = occluded[None, None]
    for _ in range(iterations):
        mean = functional.avg_pool2d(state, side, stride=1, padding=radius)
        filled = holes & (mean[:, 3:] * side**2 > 0.5)
        state = torch.where(filled, mean / mean[:, 3:], state)
        holes = holes & ~filled
    return torch.where(occluded & (state[:, 3:] > 0), state[:, :3], rgb)


def _array(tensor: Tensor) -> F32:
    array: F32 = tensor.cpu().numpy()
    return np.ascontiguousarray(array)
