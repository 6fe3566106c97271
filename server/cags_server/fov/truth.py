"""How wide the reference should have been: known only once the viewer's true pose is.

Margins follow the paper (section 4.4): the reference covers ``(1 + s_x) F_x`` by ``(1 + s_y) F_y`` of the client's
view. The exact margin is the smallest that holds every point the client sees; the fast one looks at the four corners
of the view alone, at one depth.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F64, Intrinsics, Pose
from cags_server.fov.base import MAX_REFERENCE_FOV_RAD, client_halves

FAST_DEPTH_M = 10.0
"""Depth of the corners in the fast approximation (the paper's example)."""

NEAREST = 1e-6
"""Points closer to the reference's image plane than this, or behind it, are out of any view."""


def view_rays(client: Intrinsics, columns: int, rows: int) -> F64:
    """[columns x rows, 3] directions (z = 1, camera axes) on a grid over the client's picture, borders included."""
    x = (np.linspace(0, client.width_px, columns) - client.cx_px) / client.fx_px
    y = (np.linspace(0, client.height_px, rows) - client.cy_px) / client.fy_px
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return np.concatenate([grid, np.ones((len(grid), 1))], axis=1)


def in_reference(points: F64, actual: Pose, predicted: Pose) -> F64:
    """Points [N, 3] of the actual camera's axes, in the predicted (reference) camera's axes."""
    world = points @ actual.rotation_matrix.T + np.asarray(actual.position)
    return np.asarray((world - np.asarray(predicted.position)) @ predicted.rotation_matrix)


def margins_for(points: F64, client: Intrinsics) -> tuple[float, float]:
    """Smallest margins whose view holds ``points`` [N, 3] (reference camera's axes).

    Each is at least 0 and at most what the widest allowed reference has; a point behind the camera asks for that.
    """
    out = []
    for axis, half in enumerate(client_halves(client)):
        limit = max(MAX_REFERENCE_FOV_RAD / (2 * half) - 1.0, 0.0)
        if len(points) == 0:
            out.append(0.0)
            continue
        if float(points[:, 2].min()) <= NEAREST:
            out.append(limit)
            continue
        needed = math.atan(float(np.abs(points[:, axis] / points[:, 2]).max()))
        out.append(min(max(needed / half - 1.0, 0.0), limit))
    return out[0], out[1]


def exact_margins(depth: NDArray[Any], client: Intrinsics, actual: Pose, predicted: Pose) -> tuple[float, float]:
    """Smallest margins that cover every pixel of the client's view, by ``depth`` [H, W] (z; +inf is void)."""
    height, width = depth.shape
    x = (np.arange(width) + 0.5) * (client.width_px / width)
    y = (np.arange(height) + 0.5) * (client.height_px / height)
    u, v = np.meshgrid((x - client.cx_px) / client.fx_px, (y - client.cy_px) / client.fy_px)
    seen = np.isfinite(depth)
    z = depth[seen].astype(np.float64)
    points = np.stack([u[seen] * z, v[seen] * z, z], axis=1)
    return margins_for(in_reference(points, actual, predicted), client)


def fast_margins(
    client: Intrinsics, actual: Pose, predicted: Pose, depth_m: float = FAST_DEPTH_M
) -> tuple[float, float]:
    """The paper's approximation: the four corners of the view at one depth."""
    corners = view_rays(client, 2, 2) * depth_m
    return margins_for(in_reference(corners, actual, predicted), client)


def covered_share(points: F64, reference: Intrinsics) -> float:
    """Share of ``points`` [N, 3] (reference camera's axes) inside the reference's picture."""
    z = points[:, 2]
    front = z > NEAREST
    safe = np.where(front, z, 1.0)
    x = points[:, 0] / safe * reference.fx_px + reference.cx_px
    y = points[:, 1] / safe * reference.fy_px + reference.cy_px
    slack = 1e-6  # points on the very border are covered
    inside = (x >= -slack) & (x <= reference.width_px + slack) & (y >= -slack) & (y <= reference.height_px + slack)
    return float(np.mean(front & inside))


def area_ratio(client: Intrinsics, reference: Intrinsics) -> float:
    """Area of the reference's view on the plane z = 1 against the client's: what its pixels are spread over."""
    view = reference.width_px / reference.fx_px * reference.height_px / reference.fy_px
    return view / (client.width_px / client.fx_px * client.height_px / client.fy_px)
