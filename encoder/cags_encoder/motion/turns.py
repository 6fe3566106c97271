"""Rotations of splats over frames as quaternions without jumps.

A Gaussian is symmetric under half turns about its axes, and a quaternion and its negative are the same rotation. Of
these eight equivalent quaternions, the one nearest to the previous frame's is chosen.
"""

from __future__ import annotations

import numpy as np

from cags_common.geometry import F64
from cags_common.motion.apply import product

_HALF_TURNS = np.eye(4)
CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])


def relative_turns(quats: F64, first: F64) -> F64:
    """Rotations [frames, n, 4] from the rotations ``first`` [n, 4] to ``quats`` [frames, n, 4], frame by frame."""
    out, before = np.empty(quats.shape), np.tile(_HALF_TURNS[0], (quats.shape[1], 1))
    back = first * CONJUGATE
    for at, frame in enumerate(quats):
        before = out[at] = _nearest(frame, back, before)
    return out


def _nearest(quats: F64, back: F64, before: F64) -> F64:
    """The rotation ``quats`` x ``back`` [n, 4], as the equivalent quaternion nearest to ``before`` [n, 4]."""
    candidates = [product(product(quats, np.broadcast_to(half, quats.shape)), back) for half in _HALF_TURNS]
    closeness = np.stack([(candidate * before).sum(axis=1) for candidate in candidates])
    best = np.abs(closeness).argmax(axis=0)
    rows = np.arange(len(quats))
    chosen = np.stack(candidates)[best, rows]
    nearest: F64 = np.where(closeness[best, rows] < 0, -1.0, 1.0)[:, None] * chosen
    return nearest
