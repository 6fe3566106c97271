"""The readable definition of the client's frame (float64): draw, sample what is lacking by depth, add.

The shaders are tested against it, and it serves while there is no device. Its steps: the reference is *expanded* to
what the client lacks; the depth's *holes* are filled from around them (pull-push over inverse depth);
each pixel is *projected* into the reference, left out where something nearer hides it (z-test) and faded towards the
reference's border; the sample is *added*. This is PRPA (post-render perspective alignment) as the client's last step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32, F64, Camera
from cags_common.raster.base import RenderedView
from cags_common.settings import check_settings, setting

CELL_PX = 8
"""Side of the cells whose mean depth fills holes."""

FAR = 1e6
"""Depth where nothing is known anywhere, world units."""

LEAST_WEIGHT = 1e-6


@dataclass(frozen=True)
class CorrectSettings:
    """How what is lacking is brought to the client's view."""

    depth_tolerance: float = setting(
        0.03, "a pixel is hidden where it lies this share of the depth behind what the reference shows", low=0, high=1
    )
    slope_cells: float = setting(
        1.0, "depth change over this many reference pixels of the surface's own slope hides nothing", low=0, high=8
    )
    border_px: float = setting(3.0, "corrections fade over this many reference pixels at the border", low=0, high=64)
    hole_alpha: float = setting(0.3, "pixels of less opacity take their depth from around them", low=0, high=1)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, eq=False)
class Reference:
    """What a server sent of a view, decoded."""

    coded: F32  # [h, w, 3] in [0, 1]
    camera: Camera
    picture: bool = False
    """A picture of the scene, from which the client subtracts its own view; else a companded difference."""
    knee: float = 0.1
    """Differences below it are coded about linearly."""

    def __post_init__(self) -> None:
        size = self.camera.height_px, self.camera.width_px, 3
        if self.coded.shape != size:
            raise ValueError(f"reference of shape {self.coded.shape} under a camera of {size[1]}x{size[0]}")
        if not 0 < self.knee < math.inf:
            raise ValueError(f"knee = {self.knee} must be positive; 0.05 to 0.15 suit")


@dataclass(frozen=True, eq=False)
class Corrected:
    """A frame to show."""

    rgb: F32  # [H, W, 3] in [0, 1]
    confidence: F32  # [H, W] in [0, 1]: how much of what the reference says was added


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


def compand(lack: NDArray[np.floating], knee: float) -> F64:
    """A difference in [-1, 1] in [0, 1]; 0.5 is none. Odd, fine about none: asinh with its knee at ``knee``."""
    coded = np.arcsinh(np.asarray(lack, np.float64) / knee) / np.arcsinh(1 / knee) / 2 + 0.5
    return np.asarray(np.clip(coded, 0.0, 1.0))


def expand(coded: NDArray[np.floating], knee: float) -> F64:
    """:func:`compand` undone."""
    return np.asarray(np.sinh((np.asarray(coded, np.float64) - 0.5) * 2 * np.arcsinh(1 / knee)) * knee)


def lacking(reference: Reference, own: F32 | None) -> F64:
    """What is to be added [h, w, 3]; ``own`` is the client's view from the reference camera, for pictures."""
    if not reference.picture:
        return expand(reference.coded, reference.knee)
    if own is None:
        raise ValueError("a reference that is a picture needs the client's own view of it")
    return np.asarray(reference.coded.astype(np.float64) - np.clip(own, 0.0, 1.0))


def correct(
    view: RenderedView,
    camera: Camera,
    reference: Reference,
    own: F32 | None = None,
    settings: CorrectSettings | None = None,
) -> Corrected:
    """The frame of ``view`` (with its depth), drawn from ``camera``, with what ``reference`` says is lacking."""
    settings = settings or CorrectSettings()
    assert view.depth is not None
    thin = view.alpha < settings.hole_alpha
    placement = Placement(camera, reference.camera)
    depth = filled(np.where(thin, np.inf, view.depth.astype(np.float64)))
    x, y, z, inside = _placed(depth, placement)
    hidden = _hidden(depth, (x, y, z), inside, placement, settings)
    width, height = reference.camera.width_px, reference.camera.height_px
    distance = np.minimum(np.minimum(x, width - x), np.minimum(y, height - y))
    confidence = np.where(inside & ~hidden, np.clip(distance / max(settings.border_px, 1e-6), 0.0, 1.0), 0.0)
    added = confidence[..., None] * _sampled(lacking(reference, own), x, y)
    rgb = np.clip(view.rgb + added, 0.0, 1.0)
    return Corrected(rgb.astype(np.float32), confidence.astype(np.float32))


def filled(depth: F64) -> F64:
    """``depth`` [H, W] with its holes (+inf) filled from around them; finite everywhere."""
    known = np.isfinite(depth) & (depth > 0)
    weight = known.astype(np.float64)
    inverse = weight / np.where(known, depth, 1.0)
    pixels = _cell_sums(np.ones_like(depth))
    total = _cell_sums(weight)
    smooth = _pushed(_cell_sums(inverse) / np.maximum(total, LEAST_WEIGHT), total / pixels)
    height, width = depth.shape
    u, v = (np.arange(width) + 0.5) / CELL_PX, (np.arange(height) + 0.5) / CELL_PX
    around = 1.0 / np.maximum(_bilinear(smooth, u, v), 1.0 / FAR)
    return np.where(known, depth, around)


def _cell_sums(image: F64) -> F64:
    """Sums over the cells [ceil(H / 8), ceil(W / 8)]; those at the edge may be smaller."""
    rows, columns = np.arange(0, image.shape[0], CELL_PX), np.arange(0, image.shape[1], CELL_PX)
    return np.asarray(np.add.reduceat(np.add.reduceat(image, rows, axis=0), columns, axis=1))


def _pushed(values: F64, weights: F64) -> F64:
    """``values`` where ``weights`` are 1, and a level of half the size of the same where they are less."""
    if values.size == 1:
        return values
    rows, columns = np.arange(0, values.shape[0], 2), np.arange(0, values.shape[1], 2)

    def summed(image: F64) -> F64:
        return np.asarray(np.add.reduceat(np.add.reduceat(image, rows, axis=0), columns, axis=1))

    total = summed(weights)
    coarse = _pushed(summed(values * weights) / np.maximum(total, LEAST_WEIGHT), np.minimum(total, 1.0))
    u, v = (np.arange(values.shape[1]) + 0.5) / 2, (np.arange(values.shape[0]) + 0.5) / 2
    around = _bilinear(coarse, u, v)
    share = np.minimum(weights, 1.0)
    return np.asarray(values * share + around * (1 - share))


def _bilinear(image: F64, u: F64, v: F64) -> F64:
    """``image`` [h, w] at the grid of columns ``u`` [W] and rows ``v`` [H]; the edge pixel holds beyond the centres."""
    fx, fy = np.clip(u - 0.5, 0, image.shape[1] - 1), np.clip(v - 0.5, 0, image.shape[0] - 1)
    x0, y0 = np.floor(fx).astype(int), np.floor(fy).astype(int)
    x1, y1 = np.minimum(x0 + 1, image.shape[1] - 1), np.minimum(y0 + 1, image.shape[0] - 1)
    ax, ay = (fx - x0)[None], (fy - y0)[:, None]
    top = image[y0][:, x0] * (1 - ax) + image[y0][:, x1] * ax
    bottom = image[y1][:, x0] * (1 - ax) + image[y1][:, x1] * ax
    return np.asarray(top * (1 - ay) + bottom * ay)


def _placed(depth: F64, placement: Placement) -> tuple[F64, F64, F64, NDArray[np.bool_]]:
    """x, y, z of each pixel in the reference, and whether it lies in it."""
    v, u = np.indices(depth.shape) + 0.5
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ placement.matrix[:, :3].T
    p = rays * depth[..., None] + placement.matrix[:, 3]
    z = p[..., 2]
    safe = np.where(z > 0, z, 1.0)
    x, y = p[..., 0] / safe, p[..., 1] / safe
    inside = (z > 0) & (x >= 0) & (y >= 0) & (x <= placement.reference.width_px) & (y <= placement.reference.height_px)
    return np.where(inside, x, 0.0), np.where(inside, y, 0.0), np.where(inside, z, 0.0), inside


def _hidden(
    depth: F64,
    place: tuple[F64, F64, F64],
    inside: NDArray[np.bool_],
    placement: Placement,
    settings: CorrectSettings,
) -> NDArray[np.bool_]:
    """Pixels that the reference does not see: behind the nearest one of the same reference pixel, and apart from it."""
    x, y, z = place
    row, column = np.indices(depth.shape)
    cell = y.astype(np.int64) * (placement.reference.width_px + 1) + x.astype(np.int64)
    cells = (placement.reference.width_px + 1) * (placement.reference.height_px + 1)
    sampled = inside & (row % placement.stride == 0) & (column % placement.stride == 0)
    nearest = np.full(cells, np.inf)
    np.minimum.at(nearest, cell[sampled], z[sampled])
    is_nearest = sampled & (z == nearest[cell])
    first = np.full(cells, depth.size)
    np.minimum.at(first, cell[is_nearest], np.arange(depth.size).reshape(depth.shape)[is_nearest])
    sx, sy = placement.cell_px
    away = (np.abs(column - first[cell] % depth.shape[1]) > sx) | (np.abs(row - first[cell] // depth.shape[1]) > sy)
    slack = settings.slope_cells * (sx * _slope(depth, 1) + sy * _slope(depth, 0))
    return np.asarray(inside & away & (z > nearest[cell] * (1 + settings.depth_tolerance) + slack))


def _slope(depth: F64, axis: int) -> F64:
    """The smaller of the depth steps to the two neighbours along an axis; 0 where there is none."""
    step = np.abs(np.diff(depth, axis=axis))
    if not step.size:
        return np.zeros_like(depth)
    edge = np.full_like(np.take(depth, [0], axis=axis), np.inf)
    both = np.minimum(np.concatenate([edge, step], axis=axis), np.concatenate([step, edge], axis=axis))
    return np.asarray(both)


def _sampled(image: F64, x: F64, y: F64) -> F64:
    """``image`` [h, w, 3] at continuous pixels [H, W]; past the outermost centres the edge pixel holds."""
    h, w = image.shape[:2]
    fx, fy = np.clip(x - 0.5, 0, w - 1), np.clip(y - 0.5, 0, h - 1)
    x0, y0 = np.floor(fx).astype(int), np.floor(fy).astype(int)
    x1, y1 = np.minimum(x0 + 1, w - 1), np.minimum(y0 + 1, h - 1)
    ax, ay = (fx - x0)[..., None], (fy - y0)[..., None]
    top = image[y0, x0] * (1 - ax) + image[y0, x1] * ax
    bottom = image[y1, x0] * (1 - ax) + image[y1, x1] * ax
    return np.asarray(top * (1 - ay) + bottom * ay)


def _pinhole(camera: Camera) -> F64:
    i = camera.intrinsics
    return np.array([[i.fx_px, 0.0, i.cx_px], [0.0, i.fy_px, i.cy_px], [0.0, 0.0, 1.0]])
