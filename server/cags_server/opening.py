"""The first tiles of a session: chosen before anything is rendered, by the tiles' bounds alone."""

from __future__ import annotations

import itertools

import numpy as np

from cags_common.bundle import TileEntry
from cags_common.geometry import Camera
from cags_server.library import SceneLibrary

Key = tuple[int, int]

VIEW_SLACK = 1.2
"""How far outside the picture, in half widths, a tile still counts as in view: the viewer moves, splats have extent."""


def opening_tiles(library: SceneLibrary, frame: int, camera: Camera) -> tuple[list[Key], list[Key]]:
    """(media frame, tile) of all tiles alive at ``frame``: those in view of ``camera``, nearest first, and the
    others.
    """
    in_view: list[tuple[float, Key]] = []
    hidden: list[Key] = []
    for key in library.owning_tiles(frame):
        distance = _distance_in_view(library.entry(key[0]).tiles[key[1]], camera)
        if distance is None:
            hidden.append(key)
        else:
            in_view.append((distance, key))
    return [key for _, key in sorted(in_view)], hidden


def _distance_in_view(tile: TileEntry, camera: Camera) -> float | None:
    """Distance of the nearest corner of a tile's bounds; None where no part of it can be in view.

    Conservative: the tile is out of view only if all corners lie beyond the same side of the (slackened) frustum.
    """
    corners = np.array(list(itertools.product(*zip(*tile.bounds, strict=True))))
    rotation, translation = camera.world_to_camera
    points = corners @ rotation.T + translation
    k = camera.intrinsics
    slack_x, slack_y = VIEW_SLACK * k.width_px / (2 * k.fx_px), VIEW_SLACK * k.height_px / (2 * k.fy_px)
    x, y, z = points.T
    beyond = [z < camera.near, x > slack_x * z, x < -slack_x * z, y > slack_y * z, y < -slack_y * z]
    if any(bool(side.all()) for side in beyond):
        return None
    return float(np.linalg.norm(points, axis=1).min())
