"""The first tiles of a session: chosen before anything is rendered, by the tiles' bounds alone."""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import numpy as np

from cags_common.bundle import TileEntry
from cags_common.geometry import Camera
from cags_protocol.messages import FrameEnd, TileLayers
from cags_server.library import SceneLibrary

Key = tuple[int, int]

VIEW_SLACK = 1.2
"""How far outside the picture, in half widths, a tile still counts as in view: the viewer moves, splats have extent."""


PATIENCE_US = 700_000
"""Time after which a first picture of which enough has come is shown as it is."""

ENOUGH = 0.25
"""Share of the tiles in view, nearest first, that make a first picture."""


class Opening:
    """Lets the play begin on a slow link: the first frame is ended once enough of it has come and time is up.

    What is still on its way then fills in while the play goes on.
    """

    def __init__(self, frame: int, in_view: Iterable[Key], now_us: int) -> None:
        """``in_view``: the (media frame, tile) whose base layers are on their way to the first picture of ``frame``."""
        self._frame, self._due_us = frame, now_us + PATIENCE_US
        self._waiting = set(in_view)
        self._enough = len(self._waiting) * (1 - ENOUGH)  # may be missing

    def settled(self, message: TileLayers) -> None:
        """Layers were delivered, or will never be."""
        self._waiting.discard((message.frame, message.tile))

    def due_us(self) -> int | None:
        """When :meth:`end` has something to say; None: not before more has come, or never again."""
        return self._due_us if 0 < len(self._waiting) <= self._enough else None

    def end(self, now_us: int) -> list[FrameEnd]:
        """The end of the first frame, ahead of what is still on its way; once, when it is due."""
        due_us = self.due_us()
        if due_us is None or now_us < due_us:
            return []
        self._waiting.clear()
        return [FrameEnd(self._frame)]


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
