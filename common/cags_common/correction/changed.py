"""Pixels that show splats changed since the reference: its correction is not valid there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common.correction.base import VETO_CELL_PX, veto_shape
from cags_common.geometry import F32, F64, Camera

SLABS = 32
"""Number of logarithmic depth slabs for the occlusion test."""


BEHIND = 0.1
"""Tolerance behind a cell's farthest depth within which a splat counts as visible, as a share of that depth."""


@dataclass(frozen=True, eq=False)
class Spheres:
    """Bounding spheres of splats. Raises ``ValueError`` for wrong shapes."""

    positions: NDArray[np.floating]  # [N, 3] world
    radii: NDArray[np.floating]  # [N] world units

    def __post_init__(self) -> None:
        if self.positions.shape != (len(self.radii), 3) or self.radii.ndim != 1:
            raise ValueError(
                f"positions of shape {self.positions.shape} and radii of shape {self.radii.shape}: "
                "[N, 3] and [N] wanted"
            )

    def __len__(self) -> int:
        return len(self.radii)


def changed_cells(spheres: Spheres, camera: Camera, depth: F32, tolerance: float = BEHIND) -> F32:
    """Veto [ceil(H / 16), ceil(W / 16)] for :meth:`.base.Corrector.correct`: 1 where a changed splat is visible.

    ``spheres`` bound the changed splats; ``depth`` [H, W] is that of the view from ``camera``. A splat counts as
    visible in a cell unless its near side lies behind the cell's farthest depth by more than ``tolerance`` and one step
    of the logarithmic scale; holes are infinitely far. The test is conservative. Its cost grows with N and the number
    of cells, not with the splats' sizes.

    Raises ``ValueError`` for a depth of another size.
    """
    size = camera.height_px, camera.width_px
    if depth.shape != size:
        raise ValueError(f"depth of shape {depth.shape} under a camera of {size[1]}x{size[0]}")
    shape = veto_shape(camera)
    near, boxes = cell_boxes(spheres, camera)
    if not len(near):
        return np.zeros(shape, np.float32)
    edges = _slab_edges(depth)
    reach = np.searchsorted(
        edges, _farthest(depth) * (1 + tolerance), side="right"
    )  # slabs up to this one are in front
    slab = np.searchsorted(edges, near, side="right")
    covered = np.cumsum(_coverage(slab, boxes, shape), axis=0, dtype=np.int32)  # of this slab and all nearer ones
    seen: NDArray[np.bool_] = np.take_along_axis(covered, reach[None], axis=0)[0] > 0
    return seen.astype(np.float32)


def cell_boxes(spheres: Spheres, camera: Camera) -> tuple[F64, NDArray[np.int64]]:
    """Near depths [M] of the spheres in the image, and their first and last cells [M, 4] (rows, then columns)."""
    positions, radii = np.asarray(spheres.positions, np.float64), np.asarray(spheres.radii, np.float64)
    shape = veto_shape(camera)
    rotation, shift = camera.world_to_camera
    x, y, z = (positions @ rotation.T + shift).T
    in_front = (z + radii > camera.near) & (radii > 0)
    x, y, z, radii = x[in_front], y[in_front], z[in_front], radii[in_front]
    near = np.maximum(z - radii, camera.near)
    i = camera.intrinsics
    spans = []
    for at, focal, centre, cells in ((y, i.fy_px, i.cy_px, shape[0]), (x, i.fx_px, i.cx_px, shape[1])):
        # each side's extreme is at the near or at the far side of the sphere
        low, high = at - radii, at + radii
        first = np.minimum(low / near, low / (z + radii)) * focal + centre
        last = np.maximum(high / near, high / (z + radii)) * focal + centre
        spans.append((np.floor(first / VETO_CELL_PX), np.floor(last / VETO_CELL_PX), cells))
    visible = np.ones(len(z), bool)
    for first, last, cells in spans:
        visible &= (last >= 0) & (first < cells)
    clipped = [np.clip(side, 0, cells - 1) for first, last, cells in spans for side in (first, last)]
    return near[visible], np.stack(clipped, axis=1)[visible].astype(np.int64)


def _farthest(depth: F32) -> F64:
    """Farthest depth of each cell; +inf where it has a hole."""
    whole = depth.shape[0] // VETO_CELL_PX * VETO_CELL_PX
    rows = [depth[:whole].reshape(-1, VETO_CELL_PX, depth.shape[1]).max(axis=1)]
    if whole < depth.shape[0]:
        rows.append(depth[whole:].max(axis=0)[None])
    far = np.maximum.reduceat(np.concatenate(rows), np.arange(0, depth.shape[1], VETO_CELL_PX), axis=1)
    return np.where(far > 0, far, np.inf).astype(np.float64)  # NaN is a hole too


def _slab_edges(depth: F32) -> F64:
    """Ascending depths [SLABS - 1] between the slabs."""
    known = depth[::4, ::4]
    known = known[np.isfinite(known) & (known > 0)]
    low, high = (float(known.min()), float(known.max())) if known.size else (1.0, 1.0)
    return np.geomspace(low, high * 1.5, SLABS - 1)


def _coverage(slab: NDArray[np.int64], boxes: NDArray[np.int64], shape: tuple[int, int]) -> NDArray[np.int32]:
    """Number of boxes over each cell [SLABS, rows, columns], from summed-area differences (four corners per box)."""
    rows, columns = shape[0] + 1, shape[1] + 1
    top, bottom, left, right = boxes.T
    bottom, right = bottom + 1, right + 1
    plane = slab * rows
    plus = np.concatenate([(plane + top) * columns + left, (plane + bottom) * columns + right])
    minus = np.concatenate([(plane + top) * columns + right, (plane + bottom) * columns + left])
    cells = SLABS * rows * columns
    steps = (np.bincount(plus, minlength=cells) - np.bincount(minus, minlength=cells)).astype(np.int32)
    counts = steps.reshape(SLABS, rows, columns)
    for axis in (1, 2):
        np.cumsum(counts, axis=axis, out=counts)
    return counts[:, :-1, :-1]
