"""How far a reference holds: what it says of one view is used less in another, the farther away that is.

A difference holds where the same splats lack the same colours in both views. From somewhere else other things are
seen, and depths, by which it is placed, are rough. A *small* difference is mostly blending order, which turns with the
camera besides (:mod:`cags_server.reference.lasting`). The shares are those that leave the least error, measured for
random pairs of views of two rooms at three levels each (``docs/lab/references.md``).
"""

from __future__ import annotations

import math

from cags_common.geometry import Pose, Vec3, angle_between

SMALL = 10**-4.4
"""Mean squared difference up to which one is small (44 dB); from twice as much on it is large."""

SMALL_FADES = 2.5
"""Share of a small difference that is lost per radian."""

LARGE_HOLDS, LARGE_FADES = 0.2, 2.0
"""A large difference holds up to this distance, radians, and beyond it loses this share of itself per radian."""


def apart(a: Pose, b: Pose, centre: Vec3, radius: float) -> float:
    """How far apart two views of a scene are, radians: the angle between them and that of the step from one place to
    the other, seen from the scene's focus (``centre`` and ``radius`` > 0, world units).
    """
    away = max(math.dist(b.position, centre), radius)
    return angle_between(a.rotation, b.rotation) + math.dist(a.position, b.position) / away


def smallness(mean_square: float) -> float:
    """From 1 for small differences to 0 for large ones and those of an unknown ``mean_square`` (0), RGB in [0, 1]."""
    return min(max(2 - mean_square / SMALL, 0.0), 1.0) if mean_square > 0 else 0.0


def valid_share(distance: float, smallness: float) -> float:
    """Share in [0, 1] of a reference to use at ``distance`` (:func:`apart`) from its camera; ``smallness`` in [0, 1] is
    0 for large differences and for pictures.
    """
    small = max(1 - SMALL_FADES * distance, 0.0)
    large = min(max(1 - LARGE_FADES * (distance - LARGE_HOLDS), 0.0), 1.0)
    return smallness * small + (1 - smallness) * large
