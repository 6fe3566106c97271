"""Best rigid motion of runs of splats by Horn's closed form (1987), for all runs and frames at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F64
from cags_common.motion.apply import rotate
from cags_common.motion.chunk import TURN_UNIT, Blocks

MOST_GIBBS = 1e4
"""Tangent of half the angle at 179.99 degrees: Gibbs vectors cannot express half turns."""


def rigid_blocks(anchors: F64, tracks: F64, weights: F64, size: int, unit: float) -> Blocks:
    """Rigid motion of each run of ``size`` ``anchors`` [n, 3] to ``tracks`` [frames, n, 3] with ``weights`` [n].

    ``unit`` is the unit of shifts in metres. The rest of the motion is left to the residuals of single splats.
    """
    runs = np.arange(len(anchors)) // size
    count = -(-len(anchors) // size)
    total = np.maximum(_sums(weights[:, None], runs, count), 1e-300)
    middle = _sums(anchors * weights[:, None], runs, count) / total
    spread = anchors - middle[runs]
    shifts, turns = (np.zeros((len(tracks), count, 3), np.int32) for _ in range(2))
    for at, points in enumerate(tracks):
        centre = _sums(points * weights[:, None], runs, count) / total
        away = (points - centre[runs]) * weights[:, None]
        outer = _sums((spread[:, :, None] * away[:, None, :]).reshape(-1, 9), runs, count).reshape(-1, 3, 3)
        turns[at] = np.rint(_gibbs(outer) / TURN_UNIT)
        carried = rotate(block_quaternions(turns[at]), middle)
        shifts[at] = np.clip(np.rint((centre - carried) / unit), -(2**30), 2**30)
    return Blocks(size, unit, shifts, turns)


def block_quaternions(turns: NDArray[np.int32]) -> F64:
    """Unit quaternions [runs, 4] of Gibbs vectors in ``TURN_UNIT`` [runs, 3]."""
    gibbs = turns * TURN_UNIT
    quats = np.concatenate([np.ones((len(gibbs), 1)), gibbs], axis=1)
    unit: F64 = quats / np.linalg.norm(quats, axis=1, keepdims=True)
    return unit


def carried(blocks: Blocks, anchors: F64) -> tuple[F64, F64]:
    """Positions [frames, n, 3] of ``anchors`` [n, 3] moved by their blocks, and the rotations [frames, n, 4]."""
    runs = np.arange(len(anchors)) // blocks.size
    turns = np.stack([block_quaternions(turn) for turn in blocks.turns])[:, runs]
    points = np.stack([rotate(turn, anchors) for turn in turns])
    return points + blocks.shifts[:, runs] * float(np.float32(blocks.unit)), turns


def _sums(values: F64, runs: NDArray[np.intp], count: int) -> F64:
    return np.stack([np.bincount(runs, column, count) for column in values.T], axis=1)


def _gibbs(outer: F64) -> F64:
    """Gibbs vectors [runs, 3] of the rotations that best fit sums of outer products [runs, 3, 3]."""
    s = outer
    form = np.zeros((len(s), 4, 4))
    trace = s[:, 0, 0] + s[:, 1, 1] + s[:, 2, 2]
    form[:, 0, 0] = trace
    for i, (j, k) in enumerate(((1, 2), (2, 0), (0, 1))):
        form[:, 0, i + 1] = form[:, i + 1, 0] = s[:, j, k] - s[:, k, j]
        form[:, i + 1, i + 1] = 2 * s[:, i, i] - trace
        form[:, j + 1, k + 1] = form[:, k + 1, j + 1] = s[:, j, k] + s[:, k, j]
    scale = np.maximum(np.abs(form).max(axis=(1, 2), keepdims=True), 1e-300)
    best = np.linalg.eigh(form / scale)[1][:, :, -1]
    best[~(np.abs(form).max(axis=(1, 2)) > 0)] = (1.0, 0.0, 0.0, 0.0)
    real = np.where(np.abs(best[:, :1]) < 1 / MOST_GIBBS, np.copysign(1 / MOST_GIBBS, best[:, :1]), best[:, :1])
    gibbs: F64 = best[:, 1:] / real
    return gibbs
