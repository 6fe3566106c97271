"""The first view of a scene, as the page in the browser chooses it (``web/src/player/camera.ts``), and its picture."""

from __future__ import annotations

import itertools
import math

import cv2
import numpy as np

from cags_common.bundle.manifest import Manifest
from cags_common.bundle.view import AuthorView
from cags_common.geometry import F64, Camera, Intrinsics, Pose, Vec3
from cags_common.raster.base import DepthKind, RasterScene, RenderOptions

WIDTH_PX, HEIGHT_PX = 480, 300
LONG_FOV_RAD = math.pi / 3
JPEG_QUALITY = 82

MARGIN = 1.08
"""A sphere that just touches the picture's rim has this much room around it."""
START_PITCH_RAD = -0.12
SURROUNDED, WITHIN = 1.3, 0.85
"""Bounds that reach so many radii behind the visitor are walls, and the view begins so much of the way to them."""
BULK = 2.2
"""Radii from the scene's centre beyond which splats are background, and need not be in the first view."""
LEAST_RADIUS = 1e-12
"""Smallest radius of a scene, in its units: squares of it are still normal numbers in float32."""
LEAST_SHARE = 2.0**-20
"""Smallest radius relative to the centre's coordinates: a few steps of float32, which renderers hold positions in."""


def first_camera(manifest: Manifest, width_px: int, height_px: int) -> Camera:
    """The author's first view, else one from in front that shows the scene whole, or as much as a room's walls let."""
    tangent = math.tan(LONG_FOV_RAD / 2)
    tan_x, tan_y = (tangent * size / max(width_px, height_px) for size in (width_px, height_px))
    intrinsics = Intrinsics.of_fov(width_px, height_px, 2 * math.atan(tan_x), 2 * math.atan(tan_y))
    view = manifest.view
    pose = view.pose if view is not None and view.pose is not None else first_pose(manifest, tan_x, tan_y)
    return Camera(intrinsics, pose, manifest.near)


def first_pose(manifest: Manifest, tan_x: float, tan_y: float) -> Pose:
    """T_world_camera of a first view with tangents ``tan_x`` and ``tan_y`` of half its angles."""
    forward, up = _forward(manifest)
    given = manifest.view or AuthorView()
    target = np.asarray(manifest.focus_centre if given.target is None else given.target)
    radius = max(given.radius or manifest.focus_radius, least_radius(_vec3(target)))
    distance = _round(radius, tan_x, tan_y)
    if given.target is None and given.radius is None:
        wall = _wall(manifest, -forward)
        if wall > SURROUNDED * radius:
            distance = min(distance, WITHIN * wall)
        else:
            target, distance = _fitted(manifest, radius, (forward, up), (tan_x, tan_y)) or (target, distance)
    eye = target - distance * forward
    return Pose.looking_at(_vec3(eye), _vec3(target), _vec3(up))


def thumbnail(scene: RasterScene, manifest: Manifest) -> bytes:
    """A small JPEG of the first view of ``scene``, over the author's background."""
    camera = first_camera(manifest, WIDTH_PX, HEIGHT_PX)
    view = scene.render(camera, RenderOptions(depth=DepthKind.NONE, displayed=True))
    background = manifest.view.background if manifest.view is not None else ""
    behind = np.array([int((background or "#000000")[at : at + 2], 16) / 255 for at in (1, 3, 5)], np.float32)
    rgb = np.clip(view.rgb + (1 - view.alpha[..., None]) * behind, 0.0, 1.0)
    pixels = np.ascontiguousarray((rgb * 255 + 0.5).astype(np.uint8)[..., ::-1])
    _, data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return bytes(data)


def least_radius(centre: Vec3) -> float:
    """Radius of the smallest ball around ``centre`` that can be looked at, in the scene's units; positive."""
    return max(LEAST_RADIUS, LEAST_SHARE * max(map(abs, centre)))


def _forward(manifest: Manifest) -> tuple[F64, F64]:
    """Where a first view looks, and up: unit vectors."""
    up = _unit(np.asarray(manifest.up, dtype=np.float64))
    front = _unit(np.cross((1.0, 0.0, 0.0) if abs(up[0]) < 0.9 else (0.0, 0.0, 1.0), up))
    return -math.cos(START_PITCH_RAD) * front + math.sin(START_PITCH_RAD) * up, up


def _round(radius: float, tan_x: float, tan_y: float) -> float:
    """From how far a sphere is seen whole."""
    return radius * MARGIN / math.sin(math.atan(min(tan_x, tan_y)))


def _wall(manifest: Manifest, away: F64) -> float:
    """From the scene's centre to its bounds along a direction; infinite where the centre lies outside."""
    low, high = np.asarray(manifest.bounds)
    with np.errstate(divide="ignore", invalid="ignore"):
        ways = (np.where(away > 0, high, low) - manifest.focus_centre) / away
    known = ways[np.isfinite(ways) & (ways >= 0)]
    return float(known.min()) if len(known) else math.inf


def _fitted(
    manifest: Manifest, radius: float, axes: tuple[F64, F64], tangents: tuple[float, float]
) -> tuple[F64, float] | None:
    """Centre of the bounds, and from how far along the first of ``axes`` (forward, up) they are seen whole.

    None where that is within the scene's ball. Bounds are of the splats' centres: of one splat, or of several at one
    point, they have no extent, and the ball says how large the splats are.
    """
    forward, up = axes
    target, corners = _box(manifest, radius)
    right = _unit(np.cross(forward, up))
    x, y, z = ((corners - target) @ np.stack([right, np.cross(forward, right), forward]).T).T
    distance = float(np.max(np.maximum(np.abs(x) / tangents[0], np.abs(y) / tangents[1]) - z))
    return (target, distance) if distance >= radius else None


def _box(manifest: Manifest, radius: float) -> tuple[F64, F64]:
    """Centre and corners [8, 3] of the bounds, without what lies far from the scene's centre."""
    low, high = np.asarray(manifest.bounds)
    focus = np.asarray(manifest.focus_centre)
    low, high = np.maximum(low, focus - BULK * radius), np.minimum(high, focus + BULK * radius)
    return (low + high) / 2, np.array(list(itertools.product(*zip(low, high, strict=True))))


def _unit(vector: F64) -> F64:
    return vector / np.linalg.norm(vector)


def _vec3(vector: F64) -> Vec3:
    x, y, z = (float(part) for part in vector)
    return x, y, z
