"""Converts patches to splats: surfaces are divided where their colour varies most, until every splat has a cell.

The division is greedy over all surfaces at once: each round halves the cells of the greatest error (colour variance
times area) along the side that lowers it more, so edges get small, elongated splats and plain walls get large ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F64
from cags_common.splats import SH_C0, SH_REST_OF_DEGREE, Splats
from cags_encoder.scenes import rotations
from cags_encoder.scenes.harmonics import lobe
from cags_encoder.scenes.procedural.light import Lighting, shown
from cags_encoder.scenes.procedural.patches import Patch

Ints = NDArray[np.int64]

TEXELS_PER_SPLAT = 8
FLAT = 0.0012
"""Least colour variance of a surface, so that plain surfaces are divided too."""

FINE = 0.12
"""Weight of the variance that remains after a division."""

EDGE = 0.02
"""Additional variance at the end of a surface, where splats must be small so as not to stick out."""

SIGMA = 0.50
"""Standard deviation of a splat in widths of its cell: large enough to look solid, small enough to stay sharp."""

SHARPEN = 0.7
"""Share of the difference from the surroundings that is added to a splat's colour."""

MAX_ASPECT = 4.0
ROUND_FROM = 12_000
"""With at least this many splats, curved objects get all the cells that they need."""

LIGHTMAP_M = 0.13
"""Spacing of the points at which soft light is computed, metres."""

SHARPNESS = 24.0
"""Exponent of the highlight before truncation at the SH degree."""


@dataclass(frozen=True)
class Surfel:
    """Cells of all patches as arrays of N rows, from which splats are made."""

    patch: Ints  # [N]
    points: F64  # [N, 3] metres
    normals: F64  # [N, 3]
    along_u: F64  # [N, 3] the cell's extent, metres
    along_v: F64  # [N, 3]
    rgb: F64  # [N, 3] display-referred, lit
    uv: F64  # [N, 2] parameters of the centre


class _Grid:
    """Colours of one patch on a grid of texels, with running sums for means and variances of rectangles."""

    def __init__(self, patch: Patch, texel_m: float, soft: F64, light: Lighting) -> None:
        self.width = int(np.clip(round(patch.size[0] / texel_m), 4 * patch.cells[0], 8192))
        self.height = int(np.clip(round(patch.size[1] / texel_m), 4 * patch.cells[1], 8192))
        u, v = np.meshgrid((np.arange(self.width) + 0.5) / self.width, (np.arange(self.height) + 0.5) / self.height)
        rgb = np.clip(patch.pattern(u * patch.size[0], v * patch.size[1]), 0.0, 1.0)
        if patch.finish.emission:
            rgb = np.clip(rgb * patch.finish.emission, 0.0, 1.0)
        else:
            sun = light.sunlight(patch.shape(u, v).reshape(-1, 3), patch.normals(u, v).reshape(-1, 3)).reshape(
                rgb.shape
            )
            rgb = shown(rgb**2.2 * (_resample(soft, u[0], v[:, 0]) + sun))
        values = np.concatenate([rgb, np.sum(rgb * rgb, axis=2, keepdims=True)], axis=2)
        self.sums = np.zeros((self.height + 1, self.width + 1, 4))
        self.sums[1:, 1:] = values.cumsum(axis=0).cumsum(axis=1)


def _soft_light(patches: list[Patch], light: Lighting) -> list[F64]:
    """The soft part of each patch's light on a coarse grid [h, w, 3], for all patches together."""
    shapes, points, normals = [], [], []
    for patch in patches:
        width, height = (max(2, round(size / LIGHTMAP_M)) for size in patch.size)
        u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
        shapes.append((height, width, 3))
        points.append(patch.shape(u, v).reshape(-1, 3))
        normals.append(patch.normals(u, v).reshape(-1, 3))
    soft = light.soft(np.concatenate(points), np.concatenate(normals))
    ends = np.cumsum([height * width for height, width, _ in shapes])
    return [part.reshape(shape) for part, shape in zip(np.split(soft, ends[:-1]), shapes, strict=True)]


def _resample(grid: F64, u: F64, v: F64) -> F64:
    """Bilinear samples [len(v), len(u), 3] of cell-centred ``grid`` [h, w, 3], held at its borders."""
    x, y = (
        np.clip(u * grid.shape[1] - 0.5, 0, grid.shape[1] - 1),
        np.clip(v * grid.shape[0] - 0.5, 0, grid.shape[0] - 1),
    )
    i, j = np.minimum(x.astype(int), grid.shape[1] - 2), np.minimum(y.astype(int), grid.shape[0] - 2)
    s, t = (x - i)[None, :, None], (y - j)[:, None, None]
    rows = grid[j] * (1 - t) + grid[j + 1] * t
    out: F64 = rows[:, i] * (1 - s) + rows[:, i + 1] * s
    return out


class _Cells:
    """Rectangles of texels, all patches in one set of arrays."""

    def __init__(self, patches: list[Patch], count: int, light: Lighting) -> None:
        area = sum(p.size[0] * p.size[1] * p.finish.detail for p in patches)
        texel_m = float(np.sqrt(area / (TEXELS_PER_SPLAT * count)))
        soft = _soft_light(patches, light)
        grids = [_Grid(p, texel_m / np.sqrt(p.finish.detail), s, light) for p, s in zip(patches, soft, strict=True)]
        self.widths = np.array([g.width for g in grids])
        self.heights = np.array([g.height for g in grids])
        self._offsets = np.concatenate([[0], np.cumsum((self.widths + 1) * (self.heights + 1))[:-1]])
        self._sums = np.concatenate([g.sums.reshape(-1, 4) for g in grids])
        self._texel = np.array(
            [[p.size[0] / g.width, p.size[1] / g.height] for p, g in zip(patches, grids, strict=True)]
        )
        self._detail = np.array([p.finish.detail for p in patches])

    def colours(self, cells: Ints) -> F64:
        """Colours [N, 3] for splats at ``cells`` [N, 5]: patch, left, top, right, bottom.

        The mean over the cell, moved away from the mean of its surroundings, because overlapping splats blur.
        """
        mean = self._moments(cells)[:, :3]
        return np.clip(mean + SHARPEN * (mean - self._moments(self._grown(cells))[:, :3]), 0.0, 1.0)

    def errors(self, cells: Ints) -> F64:
        """Gain of dividing each cell: the variance removed, and a little of the rest, times area and detail.

        The remaining variance is texture too fine for any splat. The variance around the cell grades neighbours' sizes.
        """
        around = self._variance(self._grown(cells))
        left = np.minimum(*(self._left(cells, axis) for axis in (0, 1)))
        beyond = 1.0 - self.areas(self._grown(cells)) / (4.0 * self.areas(cells))
        worth = np.maximum(around - left, 0.0) + FINE * left + FLAT + EDGE * np.maximum(beyond, 0.0)
        errors: F64 = worth * self.areas(cells) * self._detail[cells[:, 0]]
        return errors

    def _left(self, cells: Ints, axis: int) -> F64:
        """Mean variance [N] of the halves of ``cells`` cut across ``axis``."""
        first, second = _cut(cells, axis)
        a, b = self.areas(first), self.areas(second)
        left: F64 = (self._variance(first) * a + self._variance(second) * b) / np.maximum(a + b, 1e-12)
        return left

    def _grown(self, cells: Ints) -> Ints:
        """``cells`` extended by half their width on each side, within their patches."""
        grown = cells.copy()
        margin = (cells[:, 3:] - cells[:, 1:3] + 1) // 2
        limit = np.stack([self.widths, self.heights], axis=1)[cells[:, 0]]
        grown[:, 1:3] = np.maximum(cells[:, 1:3] - margin, 0)
        grown[:, 3:] = np.minimum(cells[:, 3:] + margin, limit)
        return grown

    def areas(self, cells: Ints) -> F64:
        """Area of each cell, square metres."""
        areas: F64 = self.sides(cells).prod(axis=1)
        return areas

    def sides(self, cells: Ints) -> F64:
        """Extent [N, 2] along u and v, metres."""
        sides: F64 = (cells[:, 3:] - cells[:, 1:3]) * self._texel[cells[:, 0]]
        return sides

    def halves(self, cells: Ints) -> tuple[Ints, Ints]:
        """Each cell cut in two, across the side whose cut leaves less variance, unless that makes it too long."""
        options = [_cut(cells, axis) for axis in (0, 1)]
        left = [self._left(cells, axis) for axis in (0, 1)]
        sides = self.sides(cells)
        flat = np.abs(left[0] - left[1]) <= 0.05 * (left[0] + left[1] + 1e-9)
        across_v = np.where(flat, sides[:, 1] > sides[:, 0], left[1] < left[0])
        across_v = np.where(sides[:, 0] > MAX_ASPECT / 2 * sides[:, 1], False, across_v)
        across_v = np.where(sides[:, 1] > MAX_ASPECT / 2 * sides[:, 0], True, across_v)
        texels = cells[:, 3:] - cells[:, 1:3]
        across_v = np.where(texels[:, 0] < 2, True, np.where(texels[:, 1] < 2, False, across_v))[:, None]
        return np.where(across_v, options[1][0], options[0][0]), np.where(across_v, options[1][1], options[0][1])

    def _variance(self, cells: Ints) -> F64:
        moments = self._moments(cells)
        variance: F64 = np.maximum(moments[:, 3] - np.sum(moments[:, :3] ** 2, axis=1), 0.0)
        return variance

    def _moments(self, cells: Ints) -> F64:
        patch, left, top, right, bottom = cells.T
        stride, base = self.widths[patch] + 1, self._offsets[patch]
        upper, lower = base + top * stride, base + bottom * stride
        total = (
            self._sums[lower + right] - self._sums[lower + left] - self._sums[upper + right] + self._sums[upper + left]
        )
        moments: F64 = total / np.maximum((right - left) * (bottom - top), 1)[:, None]
        return moments


def _cut(cells: Ints, axis: int) -> tuple[Ints, Ints]:
    middle = (cells[:, 1 + axis] + cells[:, 3 + axis]) // 2
    first, second = cells.copy(), cells.copy()
    first[:, 3 + axis] = middle
    second[:, 1 + axis] = middle
    return first, second


def divide(patches: list[Patch], count: int, light: Lighting) -> Surfel:
    """Exactly ``count`` cells over ``patches``; if that is too few for all, the smallest patches get none."""
    table = _Cells(patches, count, light)
    starts = [_start(k, p, table, min(1.0, np.sqrt(count / ROUND_FROM))) for k, p in enumerate(patches)]
    weight = np.array([p.size[0] * p.size[1] * p.finish.detail for p in patches])
    by_weight = np.argsort(-weight, kind="stable")
    fits = np.cumsum([len(starts[k]) for k in by_weight]) <= count
    cells = np.concatenate([starts[k] for k in sorted(by_weight[fits])])
    errors = table.errors(cells)
    while len(cells) < count:
        errors = np.where((cells[:, 3:] - cells[:, 1:3]).max(axis=1) > 1, errors, -1.0)
        rounds = min(count - len(cells), max(16, len(cells) // 4), int(np.count_nonzero(errors > 0)))
        if not rounds:
            break
        worst = np.sort(np.argsort(-errors, kind="stable")[:rounds])
        first, second = table.halves(cells[worst])
        cells[worst] = first
        cells = np.concatenate([cells, second])
        errors[worst] = table.errors(first)
        errors = np.concatenate([errors, table.errors(second)])
    order = np.lexsort((cells[:, 1], cells[:, 2], cells[:, 0]))
    return _surfels(patches, table, cells[order])


def _start(index: int, patch: Patch, table: _Cells, share: float) -> Ints:
    """The first cells of a patch: as many as its curvature needs, or a ``share`` of them along each side."""
    columns, rows = (max(min(n, 3), round(share * n)) for n in patch.cells)
    x = np.round(np.linspace(0, table.widths[index], columns + 1)).astype(np.int64)
    y = np.round(np.linspace(0, table.heights[index], rows + 1)).astype(np.int64)
    left, top = (grid.ravel() for grid in np.meshgrid(x[:-1], y[:-1]))
    right, bottom = (grid.ravel() for grid in np.meshgrid(x[1:], y[1:]))
    return np.stack([np.full(len(left), index), left, top, right, bottom], axis=1)


def _surfels(patches: list[Patch], table: _Cells, cells: Ints) -> Surfel:
    limit = np.stack([table.widths, table.heights], axis=1)[cells[:, 0]]
    low, high = cells[:, 1:3] / limit, cells[:, 3:] / limit
    middle = (low + high) / 2
    points, normals, along_u, along_v = (np.empty((len(cells), 3)) for _ in range(4))
    for index, patch in enumerate(patches):
        rows = slice(*np.searchsorted(cells[:, 0], [index, index + 1]))
        (u, v), (u0, v0), (u1, v1) = middle[rows].T, low[rows].T, high[rows].T
        points[rows], normals[rows] = patch.shape(u, v), patch.normals(u, v)
        along_u[rows] = patch.shape(u1, v) - patch.shape(u0, v)
        along_v[rows] = patch.shape(u, v1) - patch.shape(u, v0)
    return Surfel(cells[:, 0], points, normals, along_u, along_v, table.colours(cells), middle)


def splats_of(patches: list[Patch], surfels: Surfel, light: Lighting, degree: int) -> Splats:
    """Splats of ``surfels``: flat, along their cells, with the window's mirror image if the finish is glossy."""
    finish = [patch.finish for patch in patches]
    gloss = np.array([f.gloss for f in finish])[surfels.patch]
    opacity = np.array([f.opacity for f in finish])[surfels.patch]
    width_u, width_v = (np.maximum(np.linalg.norm(e, axis=1), 1e-4) for e in (surfels.along_u, surfels.along_v))
    thickness = 0.08 * np.minimum(width_u, width_v)
    sh = np.zeros((len(gloss), 1 + SH_REST_OF_DEGREE[degree], 3))
    sh[:, 0] = (surfels.rgb - 0.5) / SH_C0
    shiny = np.flatnonzero(gloss > 0)
    axes, strength = light.highlight_axes(surfels.points[shiny], surfels.normals[shiny])
    sh[shiny] += (lobe(axes, SHARPNESS, degree) * (gloss[shiny] * strength)[:, None])[:, :, None] * np.array(
        [1.0, 1.0, 0.95]
    )
    arrays = (
        surfels.points,
        rotations.of_frames(surfels.along_u, surfels.along_v),
        np.log(SIGMA * np.stack([width_u, width_v, thickness], axis=1)),
        np.log(opacity / (1 - opacity)),
        sh[:, 0],
        sh[:, 1:],
    )
    return Splats(*(np.ascontiguousarray(array, np.float32) for array in arrays))
