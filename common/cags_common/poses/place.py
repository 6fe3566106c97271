"""Placing a recorded walk in another scene: one rigid move and one scale, so that the walk looks at the scene.

A recorded walk lives in its own room. Its angles are what viewport prediction and streaming react to, so they are kept;
what is chosen is the point of the recorded room that becomes the scene's centre, the heading, and one scale.
"""

from __future__ import annotations

import numpy as np

from cags_common.geometry import F64
from cags_common.poses.trace import Focus, PoseTrace

DISTANCE_IN_RADII = 2.2
"""Median distance of a placed walk from the scene's centre: a sphere of the scene's radius just fills 54 degrees."""

CANDIDATE_DISTANCES_M = (1.0, 1.4, 2.0, 2.8, 4.0)
"""How far ahead of the walker the scene's centre may be put, in the recorded room's metres."""

CANDIDATE_TIMES = 64
SCORED_SAMPLES = 600
GAZE_SPREAD_RAD = np.radians(25.0)
"""A centre this far off the gaze counts 1/e of one that is looked at."""


def place(
    trace: PoseTrace, focus: Focus, *, window_us: int | None = None, distance_in_radii: float = DISTANCE_IN_RADII
) -> PoseTrace:
    """Move a recorded walk so that it looks at ``focus`` as much as it can during its first ``window_us``.

    Gravity of the trace is turned onto ``focus.up``; the walker starts out on the scene's front (+X cross up); the
    scale makes the median distance to the centre ``distance_in_radii * focus.radius``. Deterministic.
    """
    used = trace if window_us is None else trace.window(0, max(window_us, 0))
    up = gravity_up(used)
    anchor = _anchor(used, distance_in_radii)
    towards = used.positions.mean(axis=0) - anchor
    rotation = _frame(np.asarray(focus.up), np.cross((1.0, 0.0, 0.0), focus.up)) @ _frame(up, towards).T
    distance = float(np.median(np.linalg.norm(used.positions - anchor, axis=1)))
    scale = distance_in_radii * focus.radius / max(distance, 1e-6)
    return trace.moved(rotation, scale, anchor, np.asarray(focus.centre))


def gravity_up(trace: PoseTrace) -> F64:
    """Unit vector [3] against gravity in the trace's frame.

    People hardly roll their heads, so the camera's X axes lie in the horizontal plane; its normal is up. The mean of
    the cameras' up vectors, tilted by where people look, gives the sign and settles it where the head never turned.
    """
    matrices = trace.matrices
    right, mean_up = matrices[:, :, 0], -matrices[:, :, 1].mean(axis=0)
    mean_up = mean_up / max(float(np.linalg.norm(mean_up)), 1e-9)
    scatter = right.T @ right / len(trace) - 0.01 * np.outer(mean_up, mean_up)
    _, vectors = np.linalg.eigh(scatter)
    up: F64 = vectors[:, 0]
    return up if float(up @ mean_up) >= 0 else -up


def _anchor(trace: PoseTrace, distance_in_radii: float) -> F64:
    """The point [3] of the recorded room that the walker looks at most without walking into it."""
    stride = max(1, len(trace) // SCORED_SAMPLES)
    positions, gazes = trace.positions[::stride], trace.matrices[::stride, :, 2]
    picks = np.unique(np.linspace(0, len(positions) - 1, CANDIDATE_TIMES).astype(int))
    best, best_score = positions[0] + gazes[0], -1.0
    for distance in CANDIDATE_DISTANCES_M:
        for i in picks:
            candidate = positions[i] + distance * gazes[i]
            score = _score(candidate, positions, gazes, distance_in_radii)
            score *= np.exp(-0.1 * abs(np.log2(distance / 2.0)))  # two metres where nothing else decides
            if score > best_score + 1e-9:
                best, best_score = candidate, score
    return np.asarray(best, dtype=np.float64)


def _score(point: F64, positions: F64, gazes: F64, distance_in_radii: float) -> float:
    offsets = point - positions
    distances = np.maximum(np.linalg.norm(offsets, axis=1), 1e-6)
    angles = np.arccos(np.clip((offsets * gazes).sum(axis=1) / distances, -1.0, 1.0))
    radii_away = distances / np.median(distances) * distance_in_radii
    clear = np.clip((radii_away - 1.0) / 0.5, 0.0, 1.0)
    return float(np.mean(np.exp(-np.square(angles / GAZE_SPREAD_RAD)) * clear))


def _frame(up: F64, towards: F64) -> F64:
    """Rotation [3, 3] whose columns are side, up, and the horizontal part of ``towards``."""
    up = up / np.linalg.norm(up)
    level = towards - (towards @ up) * up
    if np.linalg.norm(level) < 1e-9:  # straight above or below: any heading will do
        other = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < 0.9 else np.array([0.0, 0.0, 1.0])
        level = other - (other @ up) * up
    level = level / np.linalg.norm(level)
    return np.stack([np.cross(up, level), up, level], axis=1)
