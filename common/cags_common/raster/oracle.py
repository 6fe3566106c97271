"""The ``oracle`` backend: float64, readable, the definition of right.

EWA splatting (Zwicker et al. 2001) as in 3D Gaussian Splatting (Kerbl et al. 2023): every splat is composited over
every pixel that it reaches, front to back, to the last. The cut-offs are the named constants of :mod:`.definition`; the
levels of exactness change nothing here. Slow: about a second for 30,000 splats at 400x300.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32, F64, Camera
from cags_common.raster.base import DepthKind, Footprint, RasterScene, RenderedView, RenderOptions
from cags_common.raster.checks import change, check_camera, drawable
from cags_common.raster.definition import ALPHA_CUT, ALPHA_MAX, JACOBIAN_MARGIN, MAX_DEPTH, MAX_SCALE, content_hash
from cags_common.raster.harmonics import harmonics
from cags_common.splats import SH_C0, SH_REST_OF_DEGREE, Splats


@dataclass(frozen=True, eq=False)
class ProjectedSplats:
    """Splats as a camera sees them, front to back; only those that may touch the image."""

    rows: NDArray[np.int64]  # [M] index in the scene
    centres: F64  # [M, 2] pixels, pixel (0, 0) has its centre at 0.5
    factors: F64  # [M, 3] l11, l12, l22 of the inverse covariance's Cholesky factor
    extents: F64  # [M, 2] half sizes of the box outside which alpha is under the cut, pixels
    opacities: F64  # [M] compensated for the footprint's filter
    depths: F64  # [M] camera z
    colours: F64  # [M, 3] >= 0


@dataclass(frozen=True, eq=False)
class Footstep:
    """One splat's turn in the compositing: where it is, and its alpha there."""

    index: int  # in ProjectedSplats
    window: tuple[slice, slice]  # rows, columns of the image
    alpha: F64  # [h, w]


class OracleRasteriser:
    """The backend called ``oracle``."""

    name = "oracle"

    def load(self, splats: Splats) -> RasterScene:
        """Take a copy of ``splats``. Raises :class:`cags_common.errors.SceneError` for values that cannot be drawn."""
        return OracleScene(drawable(splats))


class OracleScene:
    """Splats held by the reference backend."""

    def __init__(self, splats: Splats) -> None:
        self._splats = splats.take(slice(None))

    def __len__(self) -> int:
        return len(self._splats)

    def update(self, rows: NDArray[np.integer], splats: Splats, threads: int = 1) -> None:
        """Take the splats at ``rows`` [M] from ``splats``, those of the whole scene."""
        self._take([name for name, _ in splats.arrays()], rows, splats)

    def move(self, rows: NDArray[np.integer], splats: Splats, threads: int = 1) -> None:
        """Take position, rotation and opacity at ``rows`` [M] from ``splats``, those of the whole scene."""
        self._take(["means", "quats", "logit_opacities"], rows, splats)

    def _take(self, names: list[str], rows: NDArray[np.integer], splats: Splats) -> None:
        rows, _ = change(rows, splats, (len(self), self._splats.sh_rest.shape[1]))
        new, columns = drawable(splats.take(rows)), dict(self._splats.arrays())
        for name in names:
            columns[name] = columns[name].copy()
            columns[name][rows] = getattr(new, name)
        self._splats = Splats(**columns)

    def render(self, camera: Camera, options: RenderOptions) -> RenderedView:
        """Render one view over black."""
        projected = project(self._splats, camera, options)
        height, width = camera.height_px, camera.width_px
        rgb, transmittance = np.zeros((height, width, 3)), np.ones((height, width))
        depth = np.zeros((height, width))
        contribution = np.zeros(len(self))
        for step in footsteps(projected, camera):
            weight = transmittance[step.window] * step.alpha
            rgb[step.window] += weight[..., None] * projected.colours[step.index]
            depth[step.window] += weight * projected.depths[step.index]
            transmittance[step.window] -= weight
            contribution[projected.rows[step.index]] = weight.sum()
        alpha = 1.0 - transmittance
        return RenderedView(
            np.minimum(rgb, 1.0 if options.displayed else np.inf).astype(np.float32),
            alpha.astype(np.float32),
            _finished_depth(depth, alpha, options),
            contribution.astype(np.float32) if options.contribution else None,
        )


def project(splats: Splats, camera: Camera, options: RenderOptions) -> ProjectedSplats:
    """Project, cull and order ``splats``: by camera z rounded to float32, then by content."""
    check_camera(camera)
    rotation, _ = camera.world_to_camera
    offsets = splats.means.astype(np.float64) - np.asarray(camera.pose.position)  # [N, 3] world
    points = offsets @ rotation.T
    depths = points[:, 2].astype(np.float32)  # the precision that culls and orders
    rows = np.flatnonzero((depths > np.float32(camera.near)) & (depths < np.float32(MAX_DEPTH)))
    rows = rows[np.lexsort((content_hash(splats)[rows], depths[rows]))]
    covariance = project_covariance(splats.take(rows), points[rows], camera)  # [M, 2, 2]
    wide, kept = _widened(covariance, options.footprint)
    opacities = kept / (1.0 + np.exp(-splats.logit_opacities[rows].astype(np.float64)))
    reach = np.sqrt(2.0 * np.log(np.maximum(opacities / ALPHA_CUT, 1.0)))  # in standard deviations
    intrinsics = camera.intrinsics
    focal, principal = np.array([intrinsics.fx_px, intrinsics.fy_px]), np.array([intrinsics.cx_px, intrinsics.cy_px])
    centres = points[rows, :2] / points[rows, 2:] * focal + principal
    extents = reach[:, None] * np.sqrt(np.stack([wide[:, 0, 0], wide[:, 1, 1]], axis=1))
    size = np.array([camera.width_px, camera.height_px])
    seen = (opacities > ALPHA_CUT) & ((centres + extents > 0) & (centres - extents < size)).all(axis=1)
    colours = view_colours(splats, offsets, options.max_sh_degree)[rows]
    picked = (rows, centres, _cholesky_of_inverse(wide), extents, opacities, points[rows, 2], colours)
    return ProjectedSplats(*(array[seen] for array in picked))


def project_covariance(splats: Splats, points: F64, camera: Camera) -> F64:
    """Covariances in the image [M, 2, 2], squared pixels, of splats with camera-space centres ``points`` [M, 3]."""
    factors = _scaled_axes(splats)  # [M, 3, 3]
    fx, fy = camera.intrinsics.fx_px, camera.intrinsics.fy_px
    limit = JACOBIAN_MARGIN * 0.5 * np.array([camera.width_px / fx, camera.height_px / fy])
    z = points[:, 2]
    slopes = np.clip(points[:, :2] / z[:, None], -limit, limit)
    jacobian = np.zeros((len(points), 2, 3))
    jacobian[:, 0, 0], jacobian[:, 1, 1] = fx / z, fy / z
    jacobian[:, 0, 2], jacobian[:, 1, 2] = -fx * slopes[:, 0] / z, -fy * slopes[:, 1] / z
    rows = jacobian @ camera.world_to_camera[0] @ factors
    return rows @ rows.transpose(0, 2, 1)


def view_colours(splats: Splats, offsets: F64, max_degree: int) -> F64:
    """Colours [N, 3] >= 0 seen along ``offsets`` [N, 3] (from the camera to the splats, world, not unit)."""
    count = min(splats.sh_rest.shape[1], SH_REST_OF_DEGREE[max_degree])
    norms = np.maximum(np.linalg.norm(offsets, axis=1, keepdims=True), 1e-15)
    basis = harmonics(offsets / norms, count)
    colours = 0.5 + SH_C0 * splats.sh0.astype(np.float64)
    colours += np.einsum("nk,nkc->nc", basis, splats.sh_rest[:, :count].astype(np.float64))
    return np.maximum(colours, 0.0)


def footsteps(projected: ProjectedSplats, camera: Camera) -> Iterator[Footstep]:
    """Each projected splat's alpha over the pixels of its box, front to back."""
    columns, rows = np.arange(camera.width_px) + 0.5, np.arange(camera.height_px) + 0.5
    low, high = projected.centres - projected.extents, projected.centres + projected.extents
    size = np.array([camera.width_px, camera.height_px])
    first = np.clip(np.floor(low - 0.5), 0, size).astype(np.int64)
    last = np.clip(np.ceil(high + 0.5), 0, size).astype(np.int64)
    for i, ((x0, y0), (x1, y1)) in enumerate(zip(first.tolist(), last.tolist(), strict=True)):
        l11, l12, l22 = projected.factors[i]
        dx, dy = columns[x0:x1] - projected.centres[i, 0], rows[y0:y1] - projected.centres[i, 1]
        s = (l11 * dx)[None, :] + (l12 * dy)[:, None]
        t = l22 * dy
        alpha = np.minimum(ALPHA_MAX, projected.opacities[i] * np.exp(-0.5 * (s * s + (t * t)[:, None])))
        alpha[alpha < ALPHA_CUT] = 0.0
        yield Footstep(i, (slice(y0, y1), slice(x0, x1)), alpha)


def _scaled_axes(splats: Splats) -> F64:
    """Rotation x diag(scale) [M, 3, 3]: its columns are the Gaussians' scaled axes in the world."""
    q = splats.quats.astype(np.float64)
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    rotation = np.stack(
        [
            *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        ],
        axis=1,
    ).reshape(-1, 3, 3)
    scales = np.exp(np.minimum(splats.log_scales.astype(np.float64), np.log(MAX_SCALE)))
    return np.asarray(rotation * scales[:, None, :])


def _determinant(covariance: F64, added: float) -> F64:
    return np.asarray((covariance[:, 0, 0] + added) * (covariance[:, 1, 1] + added) - covariance[:, 0, 1] ** 2)


def _widened(covariance: F64, footprint: Footprint) -> tuple[F64, F64]:
    """Covariances [M, 2, 2] as drawn, and the factor [M] on the opacity that the footprint's filter asks for."""
    variance = footprint.dilation_px2 + footprint.filter_px2
    wide = covariance + variance * np.eye(2)
    if footprint.filter_px2 == 0:
        return wide, np.ones(len(covariance))
    ratio = _determinant(covariance, footprint.dilation_px2) / _determinant(covariance, variance)
    return wide, np.sqrt(np.clip(ratio, 0.0, 1.0))


def _cholesky_of_inverse(covariance: F64) -> F64:
    """l11, l12, l22 [M, 3] with (l11 dx + l12 dy)^2 + (l22 dy)^2 = d' S^-1 d: no cancellation where S is a needle."""
    xy, yy = covariance[:, 0, 1], covariance[:, 1, 1]
    l11 = 1.0 / np.sqrt(_determinant(covariance, 0.0) / yy)
    return np.stack([l11, -xy / yy * l11, 1.0 / np.sqrt(yy)], axis=1)


def _finished_depth(depth: F64, alpha: F64, options: RenderOptions) -> F32 | None:
    if options.depth is DepthKind.NONE:
        return None
    known = (alpha >= options.void_alpha) & (alpha > 0)
    return np.where(known, depth / np.where(known, alpha, 1.0), np.inf).astype(np.float32)
