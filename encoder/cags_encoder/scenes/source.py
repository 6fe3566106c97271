"""What the encoder reads: a sequence of Gaussian frames, and where in it there is something to look at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cags_common.geometry import F64, Vec3
from cags_common.splats import Ids, Splats

DEFAULT_FPS = 30.0
"""Frame rate of sequences that do not name one."""

MAX_FRAMES = 100_000
"""Bound on the number of frames of a scene (55 minutes at 30 fps)."""


@dataclass(frozen=True, slots=True)
class Focus:
    """The thing that a viewer walks around: a ball in the scene's own frame.

    A viewer who stays between 1 and 2.5 radii from the centre, on the scene's upper side, has a sensible view: outside
    a captured object, inside a room.
    """

    centre: Vec3  # world units
    radius: float  # world units, positive


class FrameSource(Protocol):
    """A sequence of frames in one world frame. Implementations are picklable: frames may be read in parallel."""

    @property
    def name(self) -> str:
        """Short name for titles and file names."""
        ...

    @property
    def fps(self) -> float:
        """Frames a second."""
        ...

    @property
    def up(self) -> Vec3:
        """Unit vector of the world's up direction. A hint: Gaussian files record none, most captures are y-down."""
        ...

    @property
    def focus(self) -> Focus:
        """Where walks are placed."""
        ...

    def __len__(self) -> int: ...

    def frame(self, index: int) -> Splats:
        """Frame ``index`` in 0..len-1, checked (:meth:`Splats.checked`). Splats that do not change between two frames
        are bit-identical in both. Raises :class:`SceneError` for a damaged frame and ``IndexError`` outside the range.
        """
        ...

    def ids(self, index: int) -> Ids | None:
        """Persistent identity of each row of :meth:`frame`: equal ids in two frames are the same splat, and within one
        frame ids are distinct and not negative. None where the source knows no identities.
        """
        ...


def focus_of(splats: Splats) -> Focus:
    """A robust ball around the bulk of ``splats``.

    Splats count by their opacity. The centre is halfway between the first and the last tenth on each axis, the radius
    holds four fifths of the splats: many splats are where there is detail to look at, and single floaters, plain ground
    or a far background do not move it far.
    """
    logits = np.clip(splats.logit_opacities.astype(np.float64), -30.0, 30.0)
    weight = 1.0 / (1.0 + np.exp(-logits))
    means = splats.means.astype(np.float64)
    ends = [[_weighted_quantile(means[:, axis], weight, q) for q in (0.1, 0.9)] for axis in range(3)]
    centre = np.mean(ends, axis=1)
    distance = np.linalg.norm(means - centre, axis=1)
    radius = max(_weighted_quantile(distance, weight, 0.8), 1e-3)
    return Focus((float(centre[0]), float(centre[1]), float(centre[2])), radius)


def _weighted_quantile(values: F64, weight: F64, q: float) -> float:
    order = np.argsort(values, kind="stable")
    cumulative = np.cumsum(weight[order])
    row = int(np.searchsorted(cumulative, q * cumulative[-1]))
    return float(values[order[min(row, len(values) - 1)]])
