"""Visibility by bounds, used before the first render for a client."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from cags_common.geometry import F64, Camera
from cags_server.scene.library import SceneLibrary
from cags_server.scene.tile_map import Key, Numbers, TileMap
from cags_server.scene.visible_tiles import Tally

VIEW_SLACK = 1.2
"""Margin around the picture, in half widths, within which tiles count as in view: viewers move, splats have extent."""


def opening_tiles(library: SceneLibrary, frame: int, camera: Camera) -> tuple[list[Key], list[Key]]:
    """Tiles (media frame, tile) needed for ``frame``: those in view of ``camera``, nearest first, and the others.

    Tiles in view are looks, each followed by its current motion, and then the updates of their splats. The others are
    looks alone: by the time the viewer turns to them, other motion may apply, which is sent then.
    """
    tiles, owned = library.tile_map(frame), library.owned(frame)
    numbers = np.unique(owned.looks[owned.looks >= 0])
    # Until its motion arrives, a tile is drawn where its looks lie, so both places count.
    places = _bounds(tiles, numbers, frame), np.asarray(tiles.bounds[numbers])
    distances = np.minimum(*(distances_in_view(place, camera) for place in places))
    order = np.argsort(distances, kind="stable")
    near = numbers[order[: np.isfinite(distances).sum()]]
    in_view = [n for pair in zip(near.tolist(), tiles.chunk_at(near, frame).tolist(), strict=True) for n in pair]
    if owned.updates is not None:
        in_view += np.unique(owned.updates[:, np.isin(owned.looks, near)]).tolist()
    hidden = np.setdiff1d(numbers, near)
    return [tiles.key(n) for n in in_view if n >= 0], [tiles.key(int(n)) for n in hidden]


def _bounds(tiles: TileMap, looks: Numbers, frame: int) -> F64:
    """Bounds [m, 2, 3] of tiles of looks at their place in ``frame``."""
    chunks = tiles.chunk_at(looks, frame)
    return np.asarray(tiles.bounds[np.where(chunks >= 0, chunks, looks)])


def tile_distances(library: SceneLibrary, frame: int, looks: Numbers, camera: Camera) -> F64:
    """Distance [n] of the nearest corner of each of the tiles ``looks`` [n] at ``frame``; inf where out of view."""
    return distances_in_view(_bounds(library.tile_map(frame), looks, frame), camera)


def guessed_looks(library: SceneLibrary, frame: int, camera: Camera, pixels: int) -> Tally:
    """Tiles of looks of which a picture of ``pixels`` may show something, and how much, from tile bounds alone.

    Splats of tiles in view share the pixels by the inverse square of their tile's distance; occlusion is ignored.
    """
    every = library.all_looks(frame)
    distances = tile_distances(library, frame, every.numbers, camera)
    near = np.flatnonzero(np.isfinite(distances))
    seen = every.rows(near)
    shares = seen.counts / np.square(np.maximum(distances[near], camera.near))
    return replace(seen, weights=shares * (pixels / shares.sum()) if len(shares) else shares)


def distances_in_view(bounds: F64, camera: Camera) -> F64:
    """Distance [n] of the nearest corner of each of ``bounds`` [n, 2, 3]; inf if no part can be in view.

    Conservative: a tile is out of view only if all corners lie beyond the same side of the (slackened) frustum.
    """
    corners = np.stack([bounds[:, ends, range(3)] for ends in itertools.product((0, 1), repeat=3)], axis=1)
    rotation, translation = camera.world_to_camera
    points = corners @ rotation.T + translation
    k = camera.intrinsics
    slack_x, slack_y = VIEW_SLACK * k.width_px / (2 * k.fx_px), VIEW_SLACK * k.height_px / (2 * k.fy_px)
    x, y, z = np.moveaxis(points, -1, 0)
    sides = [z < camera.near, x > slack_x * z, x < -slack_x * z, y > slack_y * z, y < -slack_y * z]
    beyond = np.any([side.all(axis=1) for side in sides], axis=0)
    return np.asarray(np.where(beyond, np.inf, np.linalg.norm(points, axis=-1).min(axis=1)))
