"""Views from likely viewpoints, and the contribution of each splat to them."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence

import numpy as np

from cags_common.geometry import DEFAULT_NEAR, F64, Camera, Intrinsics, Pose, Vec3
from cags_common.raster import DepthKind, Rasteriser, RenderOptions
from cags_common.splats import Splats
from cags_encoder.scenes import Focus

WIDTH_PX, HEIGHT_PX, FOV_RAD = 400, 300, math.radians(55)
DISTANCES = (1.4, 2.2)
"""Distances from the centre, in radii, between which views alternate: within the range of sensible views."""

HEIGHTS = (0.25, 0.25, 0.7)
"""Heights above the centre of successive views, relative to the horizontal distance."""

RADII_OF_NEAR = 10
"""Near planes that a scene's radius has, in scenes so small that the papers' near plane would cut them."""


LEAST_PLAYED_NEAR = 1e-6
"""Smallest near plane that a client may tell a server (:class:`cags_protocol.wire.messages.Hello`), in world units."""

_log = logging.getLogger(__name__)


def near_plane(focus: Focus) -> float:
    """Near plane for players of a scene of this size. Logs a warning for scenes too small to be played well."""
    near = _near(focus)
    if near < LEAST_PLAYED_NEAR:
        _log.warning(
            "scene of radius %.3g: players cut off what is nearer than %g; scale the scene to a radius of %g or more",
            focus.radius,
            LEAST_PLAYED_NEAR,
            LEAST_PLAYED_NEAR * RADII_OF_NEAR,
        )
    return max(near, LEAST_PLAYED_NEAR)


def _near(focus: Focus) -> float:
    """Near plane before which no splat of interest lies in sensible views."""
    return min(DEFAULT_NEAR, float(focus.radius) / RADII_OF_NEAR)


def cameras_around(focus: Focus, up: Vec3, views: int, phase: float = 0.3) -> list[Camera]:
    """``views`` cameras around and above the focus, looking at it, turned by ``phase`` of the angle between two."""
    upward = np.asarray(up) / np.linalg.norm(up)
    aside = np.cross(upward, np.eye(3)[np.argmin(np.abs(upward))])
    aside /= np.linalg.norm(aside)
    ahead = np.cross(upward, aside)
    height_rad = FOV_RAD * HEIGHT_PX / WIDTH_PX
    intrinsics = Intrinsics.of_fov(WIDTH_PX, HEIGHT_PX, FOV_RAD, height_rad)
    out = []
    for view in range(views):
        turn = 2 * math.pi * (view + phase) / views
        direction = math.cos(turn) * aside + math.sin(turn) * ahead + HEIGHTS[view % len(HEIGHTS)] * upward
        x, y, z = np.asarray(focus.centre) + focus.radius * DISTANCES[view % 2] * direction
        pose = Pose.looking_at((float(x), float(y), float(z)), focus.centre, up)
        out.append(Camera(intrinsics, pose, _near(focus)))
    return out


def contributions(splats: Splats, cameras: Sequence[Camera], rasteriser: Rasteriser) -> F64:
    """Contribution of each splat [n]: its compositing weights, summed over the pixels of all views."""
    options = RenderOptions(depth=DepthKind.NONE, contribution=True)
    scene, total = rasteriser.load(splats), np.zeros(len(splats))
    for camera in cameras:
        weights = scene.render(camera, options).contribution
        assert weights is not None
        total += weights
    return total
