"""What has changed since a reference was made: there it says nothing that could be relied on.

The client shows exactly what a reference assumes when it shows the reference's own frame. At later frames, while no
other has come, splats may have got other looks, been refined, moved or ended; and a client that had nothing to wait for
may have shown more than a reference assumes that comes after all.

A difference says what a splat lacked with the looks that it had. With other looks it lacks something else, even if they
arrived in time and before the mark that the difference assumes. A picture stays right where splats are refined, but not
where their looks have changed since its own frame.

Where splats move as the reference assumes, its correction stays mostly right: what the client lacked of a splat a frame
ago, it lacks near there now. This does not hold for motion that has arrived since, nor for a picture, from which the
client's render of where the splats are now is subtracted.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common.correction import Spheres
from cags_common.geometry import F32, Camera
from cags_common.splats import Splats

REMEMBERED = 64
"""Commits; what was changed before them counts no more: no reference is that old."""

REMEMBERED_FRAMES, MOST_PLACES_BYTES = 12, 64 << 20
"""Frames of which it is remembered where splats were, and memory for that."""

SEEN_SIGMAS = 2.0
"""Radius in which a splat is seen, standard deviations."""

MOST_LOOKED_AT = 4096
"""Changed splats of which it is worked out where they are seen: of more every so many-th, for cells are coarse."""

MOVED_PX = 2.0
"""Reference pixels by which a splat may have moved since without being taken for changed."""


@dataclass(frozen=True, eq=False)
class _Commit:
    """What one commit changed."""

    mark: int
    """Up to which it showed what had come, or which an earlier commit reached."""
    rows: NDArray[np.intp]
    began: NDArray[np.int32]

    def after(self, frame: int, basis: int | None) -> NDArray[np.intp]:
        """Rows that a reference of media ``frame`` does not assume: a difference that assumes mark ``basis``, or a
        picture (None).
        """
        return self.rows if basis is not None and self.mark > basis else self.rows[self.began > frame]


class Changes:
    """The commits of late of one scene: what each changed, and the mark up to which it showed."""

    def __init__(self) -> None:
        self._commits: deque[_Commit] = deque(maxlen=REMEMBERED)
        self._places: deque[tuple[int, F32]] = deque(maxlen=REMEMBERED_FRAMES)
        self._frame = -1  # that was committed last
        self._mark = self._newest = 0  # of what is displayed; the newest that ever was

    def clear(self) -> None:
        """Another group of frames is on display."""
        self._mark, self._frame = 0, -1
        self._commits.clear()
        self._places.clear()

    def committed(self, frame: int, mark: int, rows: NDArray[np.intp], began: NDArray[np.int32]) -> None:
        """``rows`` [n] changed by showing ``frame`` with what came up to ``mark``, or further, where that was shown
        before; ``began`` [n]: the media frame of what changed each.
        """
        if frame < self._frame:  # the play went back
            self._commits.clear()
        self._frame, self._mark, self._newest = frame, mark, max(self._newest, mark)
        if len(rows):
            self._commits.append(_Commit(self._newest, rows, began))

    def used(self, basis: int) -> None:
        """A reference made from mark ``basis`` is shown with its own frame."""
        self._commits = deque((commit for commit in self._commits if commit.mark > basis), REMEMBERED)

    def shown(self, frame: int, means: F32) -> None:
        """Media ``frame`` is shown, when splats are at ``means`` [N, 3]."""
        while self._places and self._places[-1][0] >= frame:  # the play went back
            self._places.pop()
        if len(self._places) * means.nbytes > MOST_PLACES_BYTES:
            self._places.popleft()
        self._places.append((frame, means.copy()))

    def since(self, frame: int, basis: int) -> bool:
        """Whether anything is shown that a difference of ``frame`` does not assume, which assumes mark ``basis``."""
        return self._mark > basis or any(len(commit.after(frame, basis)) for commit in self._commits)

    def spheres(self, since: tuple[int, int | None], splats: Splats, camera: Camera, focal_px: float) -> Spheres:
        """Around what was changed ``since`` a reference: its media frame, and the mark that a difference assumes. Of a
        picture (None), and where more than that mark is shown, also around what has moved since that frame, as seen at
        ``focal_px`` from about ``camera``.
        """
        frame, basis = since
        rows = [commit.after(frame, basis) for commit in self._commits]
        if basis is None or self._mark > basis:
            rows.append(self._moved(frame, splats, camera, focal_px))
        changed = np.unique(np.concatenate(rows)) if rows else np.zeros(0, np.intp)
        changed = changed[:: -(-len(changed) // MOST_LOOKED_AT) or 1]
        radii = SEEN_SIGMAS * np.exp(splats.log_scales[changed]).max(axis=1, initial=0.0)
        return Spheres(splats.means[changed], radii)

    def _moved(self, frame: int, splats: Splats, camera: Camera, focal_px: float) -> NDArray[np.intp]:
        before = [means for shown, means in self._places if shown <= frame] or [m for _, m in self._places][:1]
        if not before or len(before[-1]) != len(splats):
            return np.zeros(0, np.intp)
        step = np.linalg.norm(splats.means - before[-1], axis=1)
        rotation, translation = camera.world_to_camera
        depth = np.maximum(splats.means @ rotation[2] + translation[2], camera.near)
        return np.flatnonzero(step * focal_px > MOVED_PX * depth)
