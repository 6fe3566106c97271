"""How far a difference holds: what is lacking in one view is added less in another, the farther away that is.

A difference holds where the same splats lack the same colours in both views. From somewhere else other things are
seen, and depths, by which it is placed, are rough. A *small* difference may be mostly blending order, which turns with
the camera besides, or an error of the looks, which stays: two differences in a row tell
(:mod:`cags_server.reference.lasting`). Up to its *reach* all of it is used, and less beyond. Measured for
pairs of views: ``docs/lab/references.md``.
"""

from __future__ import annotations

import math

from cags_common.geometry import Pose, Vec3, angle_between

HOLDS = 0.2
"""Reach of large differences, radians; that of small ones is not larger."""

FADES = 2.5
"""Share that is lost per radian beyond the reach."""


def apart(a: Pose, b: Pose, centre: Vec3, radius: float) -> float:
    """How far apart two views of a scene are, radians: the angle between them and that of the step from one place to
    the other, seen from the scene's focus (``centre`` and ``radius`` > 0, world units).
    """
    away = max(math.dist(b.position, centre), radius)
    return angle_between(a.rotation, b.rotation) + math.dist(a.position, b.position) / away


def valid_share(distance: float, reach: float) -> float:
    """Share in [0, 1] of a difference to use at ``distance`` (:func:`apart`) from its camera."""
    return min(max(1 - FADES * (distance - reach), 0.0), 1.0)
