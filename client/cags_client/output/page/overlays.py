"""What is drawn over the picture: a mask of occluded pixels, a map of detail, tile boxes, and the reference's outline.

Masks and maps are small byte grids that the page colours; outlines are lines in picture coordinates, so that they stay
sharp at any size.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise, product

import cv2
import numpy as np
from numpy.typing import NDArray

from cags_client.output.page.controls import ShownFrame, SplatDetail
from cags_common.geometry import F32, F64, Camera

GRID_PX = 4
"""Pixels of the picture a cell of a mask."""

DETAIL_PX = 8
"""Pixels of the picture a cell of the detail map."""

FILL_CELLS = (3, 7, 15, 31, 63)
"""Sides of the squares from which a cell of the detail map without a splat's centre takes its value."""

SURFACE_TOLERANCE = 0.1
"""A splat this share of the depth behind the surface still belongs to it."""

EDGE_STEPS = 12
"""Points along each edge of the reference's outline; straight edges may bend where depth is bounded."""

MAX_BOXES = 400
"""Boxes drawn at most, the nearest ones: beyond that a picture shows nothing but lines."""

_CORNERS: F64 = np.array(list(product((0.0, 1.0), repeat=3)))
_EDGES = tuple(
    (a, b) for a, b in product(range(8), repeat=2) if a < b and int(np.abs(_CORNERS[a] - _CORNERS[b]).sum()) == 1
)


@dataclass(frozen=True, eq=False)
class Grid:
    """A byte an area of the picture, row by row."""

    name: str
    values: NDArray[np.uint8]  # [h, w]


def occlusion_grid(shown: ShownFrame) -> Grid | None:
    """1 where this view sees what the reference cannot: bytes [H/4, W/4], 255 for all of a cell."""
    if shown.occluded is None:
        return None
    return Grid("occlusion", _shrunk(shown.occluded.astype(np.uint8) * np.uint8(255)))


def confidence_grid(shown: ShownFrame) -> Grid | None:
    """How much the reference says: bytes [H/4, W/4], 0 nothing to 255 everything."""
    confidence = shown.confidence
    if confidence is None:
        return None
    return Grid("confidence", _shrunk(np.asarray(confidence * 255.0, dtype=np.uint8)))


def _shrunk(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    height, width = image.shape
    size = (max(1, width // GRID_PX), max(1, height // GRID_PX))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def detail_grid(held: SplatDetail, shown: ShownFrame) -> Grid:
    """Mean detail of the splats seen in each cell: bytes [H/8, W/8], 0 where none is, 1 (base only) to 255 (all).

    Splats behind what the picture shows there do not count. Cells of a surface in which no splat has its centre, for
    large ones cover many, have the mean of those nearest.
    """
    i = shown.camera.intrinsics
    width, height = max(1, i.width_px // DETAIL_PX), max(1, i.height_px // DETAIL_PX)
    rotation, translation = shown.camera.world_to_camera
    points = held.means @ rotation.T.astype(np.float32) + translation.astype(np.float32)
    z = np.maximum(points[:, 2], np.float32(1e-6))
    x = ((points[:, 0] / z * i.fx_px + i.cx_px) / DETAIL_PX).astype(np.int64)
    y = ((points[:, 1] / z * i.fy_px + i.cy_px) / DETAIL_PX).astype(np.int64)
    seen = (held.tiles >= 0) & (points[:, 2] > shown.camera.near) & (x >= 0) & (x < width) & (y >= 0) & (y < height)
    solid = np.zeros((height, width), bool)
    depth = shown.depth
    if depth is not None:
        surface = cv2.resize(depth, (width, height), interpolation=cv2.INTER_NEAREST)
        seen[seen] = z[seen] <= surface[y[seen], x[seen]] * np.float32(1 + SURFACE_TOLERANCE)
        solid = np.isfinite(surface)
    cells = y[seen] * width + x[seen]
    count = np.bincount(cells, minlength=width * height).reshape(height, width).astype(np.float64)
    total = np.asarray(np.bincount(cells, weights=held.detail[seen], minlength=width * height), np.float64)
    total = total.reshape(height, width)
    _fill(total, count, solid)
    values = np.where(count > 0, 1 + 254 * total / np.maximum(count, 1), 0).astype(np.uint8)
    return Grid("detail", values)


def _fill(total: F64, count: F64, wanted: NDArray[np.bool_]) -> None:
    """Give cells [h, w] that are ``wanted`` and empty the sums of a square about them, the smallest that holds any."""
    for reach in FILL_CELLS:
        empty = wanted & (count == 0)
        if not empty.any():
            return
        sums = (
            cv2.boxFilter(s, -1, (reach, reach), normalize=False, borderType=cv2.BORDER_CONSTANT)
            for s in (total, count)
        )
        for into, around in zip((total, count), sums, strict=True):
            into[empty] = around[empty]


def tile_boxes(held: SplatDetail, camera: Camera) -> list[dict[str, object]]:
    """Edges of the tiles in view: ``{"detail": share, "lines": [[x0, y0, x1, y1], ...]}`` in shares of the picture."""
    rotation, translation = camera.world_to_camera
    boxes: list[tuple[float, dict[str, object]]] = []
    for low, high, detail in _bounds(held):
        corners = (low + _CORNERS * (high - low)) @ rotation.T + translation
        segments = (_clipped_segment(corners[a], corners[b], camera) for a, b in _EDGES)
        lines = [line for line in segments if line]
        if lines:
            boxes.append((float(corners[:, 2].mean()), {"detail": round(detail, 3), "lines": lines}))
    boxes.sort(key=lambda box: box[0])
    return [box for _, box in boxes[:MAX_BOXES]]


def _bounds(held: SplatDetail) -> Iterator[tuple[F32, F32, float]]:
    """Lowest and highest corner [3] and mean detail of each tile that still has splats."""
    rows = np.nonzero(held.tiles >= 0)[0]
    if not len(rows):
        return
    rows = rows[np.argsort(held.tiles[rows], kind="stable")]
    starts = np.nonzero(np.diff(held.tiles[rows], prepend=-1))[0]
    means = held.means[rows]
    lows, highs = np.minimum.reduceat(means, starts), np.maximum.reduceat(means, starts)
    counts = np.diff(starts, append=len(rows))
    details = np.add.reduceat(held.detail[rows], starts) / counts
    for low, high, detail in zip(lows, highs, details, strict=True):
        yield low, high, float(detail)


def reference_outline(shown: ShownFrame, depth: float) -> list[list[float]]:
    """Lines ``[x0, y0, x1, y1]`` (shares of the picture): the reference's picture border, seen at ``depth`` from it."""
    reference = shown.reference_camera
    if reference is None:
        return []
    i = reference.intrinsics
    w, h = float(i.width_px), float(i.height_px)
    corners = np.array([[0, 0], [w, 0], [w, h], [0, h], [0, 0]])
    steps = np.linspace(0, 1, EDGE_STEPS, endpoint=False)[:, None]
    border = np.concatenate([a + steps * (b - a) for a, b in pairwise(corners)] + [corners[-1:]])
    rays = np.stack(
        [(border[:, 0] - i.cx_px) / i.fx_px, (border[:, 1] - i.cy_px) / i.fy_px, np.ones(len(border))], axis=1
    )
    world = (rays * depth) @ reference.pose.rotation_matrix.T + np.asarray(reference.pose.position)
    rotation, translation = shown.camera.world_to_camera
    points = world @ rotation.T + translation
    lines = (_clipped_segment(a, b, shown.camera) for a, b in pairwise(points))
    return [line for line in lines if line]


def _clipped_segment(a: F64, b: F64, camera: Camera) -> list[float]:
    """A camera-space segment in shares of the picture; empty where it lies behind the near plane."""
    near = camera.near
    if a[2] < near and b[2] < near:
        return []
    if a[2] < near:
        a = a + (b - a) * (near - a[2]) / (b[2] - a[2])
    elif b[2] < near:
        b = b + (a - b) * (near - b[2]) / (a[2] - b[2])
    i = camera.intrinsics
    x = [(float(p[0] / p[2]) * i.fx_px + i.cx_px) / i.width_px for p in (a, b)]
    y = [(float(p[1] / p[2]) * i.fy_px + i.cy_px) / i.height_px for p in (a, b)]
    if max(x) < -1 or min(x) > 2 or max(y) < -1 or min(y) > 2:
        return []
    return [round(v, 4) for v in (x[0], y[0], x[1], y[1])]
