"""The encoder's input: a sequence of Gaussian frames, and the region of interest in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cags_common.bundle.first_view import least_radius
from cags_common.geometry import F64, Vec3
from cags_common.splats import Ids, Splats

DEFAULT_FPS = 30.0
"""Frame rate of sequences that do not record one."""

MAX_FRAMES = 100_000
"""Largest number of frames of a scene (55 minutes at 30 fps)."""

SEEN_SIGMAS = 3.0
"""Standard deviations from its centre to where a splat is hardly seen any more."""

LARGEST_LOG_SCALE = 25.0
"""Larger standard deviations (logarithm) count as this one, so that the ball's radius is one that bundles may have."""


@dataclass(frozen=True, slots=True)
class Focus:
    """The object that a viewer walks around: a ball in the scene's frame.

    Views between 1 and 2.5 radii from the centre, on the scene's upper side, are sensible: outside a captured object,
    or inside a room.
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
        """Frames per second."""
        ...

    @property
    def up(self) -> Vec3:
        """Unit vector of the up direction. A guess: Gaussian files do not record it, and most captures have y down."""
        ...

    @property
    def focus(self) -> Focus:
        """Centre and size of walks."""
        ...

    def __len__(self) -> int: ...

    def frame(self, index: int) -> Splats:
        """Frame ``index`` in 0..len-1, checked (:meth:`Splats.checked`).

        Splats that do not change between two frames are bit-identical in both. Raises :class:`SceneError` for damaged
        frames and ``IndexError`` outside the range.
        """
        ...

    def ids(self, index: int) -> Ids | None:
        """Persistent identity of each row of :meth:`frame`, or None if the source knows no identities.

        Equal ids in two frames are the same splat. Within a frame ids are distinct and not negative.
        """
        ...


def is_still(source: FrameSource) -> bool:
    """Whether the frames of ``source`` are one: it says so by ``still``, and returns the same arrays for each.

    Such a scene is read in this process, and what is the same object needs no comparison. A capture may have millions
    of splats, and a copy of it for each frame would take more time than all the rest.
    """
    return bool(getattr(source, "still", False))


def focus_of(splats: Splats) -> Focus:
    """A robust ball around the bulk of ``splats``.

    Splats are weighted by opacity. On each axis, the centre is halfway between the first and the last decile; the
    radius encloses four fifths of the weight, or, where that is more, a splat of the middle size: a single splat has a
    size too. Regions of interest have many splats, so single floaters, plain ground or a far background hardly move the
    ball. The ball scales with the scene, whatever its unit.
    """
    logits = np.clip(splats.logit_opacities.astype(np.float64), -30.0, 30.0)
    weight = 1.0 / (1.0 + np.exp(-logits))
    means = splats.means.astype(np.float64)
    ends = [[_weighted_quantile(means[:, axis], weight, q) for q in (0.1, 0.9)] for axis in range(3)]
    centre = np.mean(ends, axis=1)
    distance = np.linalg.norm(means - centre, axis=1)
    sizes = np.exp(np.minimum(splats.log_scales.max(axis=1).astype(np.float64), LARGEST_LOG_SCALE))
    middle = (float(centre[0]), float(centre[1]), float(centre[2]))
    spread, size = _weighted_quantile(distance, weight, 0.8), _weighted_quantile(sizes, weight, 0.5)
    return Focus(middle, max(spread, SEEN_SIGMAS * size, least_radius(middle)))


def _weighted_quantile(values: F64, weight: F64, q: float) -> float:
    order = np.argsort(values, kind="stable")
    cumulative = np.cumsum(weight[order])
    row = int(np.searchsorted(cumulative, q * cumulative[-1]))
    return float(values[order[min(row, len(values) - 1)]])
