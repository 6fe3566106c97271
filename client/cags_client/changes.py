"""What has changed since a reference was made: there it says nothing that could be relied on.

The client shows exactly what a reference assumes when it shows the reference's own frame. At later frames, while no
other has come, splats may have been refined, or have moved; and a client that had nothing to wait for may have shown
more than a reference assumes that comes after all.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from cags_common.correction import changed_cells
from cags_common.geometry import F32, Camera
from cags_common.splats import Splats

REMEMBERED = 64
"""Commits; what was changed before them counts no more: no reference is that old."""

SEEN_SIGMAS = 2.0
"""Radius in which a splat is seen, standard deviations."""

MOVED_PX = 2.0
"""Reference pixels by which a splat may have moved since without being taken for changed."""


class Changes:
    """The commits of late of one scene: what each changed, and the mark up to which it showed."""

    def __init__(self) -> None:
        self._commits: deque[tuple[int, NDArray[np.intp]]] = deque(maxlen=REMEMBERED)
        self._means = np.zeros((0, 3), np.float32)
        self._mark = 0

    def clear(self) -> None:
        """Another group of frames is on display."""
        self._commits.clear()
        self._means = np.zeros((0, 3), np.float32)

    def committed(self, mark: int, rows: NDArray[np.intp]) -> None:
        """``rows`` changed by showing what came up to ``mark``, or further, where that was shown before."""
        self._mark = max(self._mark, mark)
        if len(rows):
            self._commits.append((self._mark, rows))

    def used(self, means: F32, basis: int) -> None:
        """A reference made from mark ``basis`` is shown with its own frame, when splats are at ``means`` [N, 3]."""
        self._means = means.copy()
        self._commits = deque(((mark, rows) for mark, rows in self._commits if mark > basis), REMEMBERED)

    def since(self, basis: int) -> bool:
        """Whether splats were changed by what came after mark ``basis``."""
        return any(mark > basis for mark, _ in self._commits)

    def veto(self, basis: int | None, splats: Splats, depth: F32, camera: Camera, focal_px: float) -> F32:
        """Where a view of ``depth`` [H, W] from ``camera`` shows what was changed since mark ``basis`` (None: that does
        not matter), or has moved in a reference of ``focal_px``: a veto for correctors
        (:func:`~cags_common.correction.changed_cells`).
        """
        rows = [] if basis is None else [changed for mark, changed in self._commits if mark > basis]
        changed = np.unique(np.concatenate([*rows, self._moved(splats, camera, focal_px)]))
        radii = SEEN_SIGMAS * np.exp(splats.log_scales[changed]).max(axis=1, initial=0.0)
        return changed_cells(splats.means[changed], radii, camera, depth)

    def _moved(self, splats: Splats, camera: Camera, focal_px: float) -> NDArray[np.intp]:
        if len(self._means) != len(splats):
            return np.zeros(0, np.intp)
        step = np.linalg.norm(splats.means - self._means, axis=1)
        rotation, translation = camera.world_to_camera
        depth = np.maximum(splats.means @ rotation[2] + translation[2], camera.near)
        return np.flatnonzero(step * focal_px > MOVED_PX * depth)
