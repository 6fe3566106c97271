"""Deterministic synthetic walks around a scene, in five kinds of motion.

Speeds are those of people: gaze that drifts at up to 60 degrees a second, turns of up to 83 degrees in a third of
a second (peak near 400 degrees a second), steps at 1.8 Hz, tracker noise of a tenth of a degree.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cags_common.errors import TraceError
from cags_common.geometry import F64, quaternion_of_matrix
from cags_common.poses.place import DISTANCE_IN_RADII
from cags_common.poses.trace import Focus, PoseTrace

RATE_HZ = 72
"""Samples a second: a headset's."""

DEFAULT_DURATION_S = 60.0

Motion = tuple[F64, F64, F64, F64, F64]
"""[N] each: arc around the scene (rad), height and advance (distances), yaw and pitch off the centre (rad)."""


def synthetic_walk(
    kind: str, focus: Focus, *, seed: int = 0, duration_s: float = DEFAULT_DURATION_S, rate_hz: int = RATE_HZ
) -> PoseTrace:
    """A walk of ``kind`` (of :data:`KINDS`) that looks at ``focus``; the same arguments give the same walk.

    Raises :class:`TraceError` for an unknown kind.
    """
    if kind not in KINDS:
        raise TraceError(f"synthetic walk {kind!r} is unknown; known: {', '.join(KINDS)}")
    n = max(1, round(duration_s * rate_hz))
    t = np.arange(n) / rate_hz
    motion = KINDS[kind](t, np.random.default_rng(seed))
    times_us = np.round(t * 1e6).astype(np.int64)
    positions, matrices = _poses(focus, motion)
    return PoseTrace(times_us, positions, np.array([quaternion_of_matrix(m) for m in matrices]))


def _poses(focus: Focus, motion: Motion) -> tuple[F64, F64]:
    """Positions [N, 3] and camera-to-world rotations [N, 3, 3]."""
    arc, height, advance, yaw, pitch = motion
    up: F64 = np.asarray(focus.up) / np.linalg.norm(focus.up)
    front = np.cross((1.0, 0.0, 0.0), up)
    if np.linalg.norm(front) < 1e-9:
        front = np.array([0.0, 0.0, 1.0])
    front = front / np.linalg.norm(front)
    side = np.cross(up, front)
    distance = DISTANCE_IN_RADII * focus.radius
    level = np.cos(arc)[:, None] * front + np.sin(arc)[:, None] * side
    positions = np.asarray(focus.centre) + distance * ((1 - advance)[:, None] * level + height[:, None] * up)
    forward: F64 = np.asarray(focus.centre) - positions
    forward = forward / np.linalg.norm(forward, axis=1, keepdims=True)
    right: F64 = np.cross(forward, up)
    right = right / np.linalg.norm(right, axis=1, keepdims=True)
    look = np.stack([right, np.cross(forward, right), forward], axis=2)
    return np.asarray(positions, dtype=np.float64), np.asarray(look @ _turn(yaw, pitch), dtype=np.float64)


def _turn(yaw: F64, pitch: F64) -> F64:
    """[N, 3, 3]: yaw to the right, then pitch up, in the camera's frame."""
    cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    zero, one = np.zeros_like(yaw), np.ones_like(yaw)
    about_y = np.moveaxis(np.array([[cy, zero, sy], [zero, one, zero], [-sy, zero, cy]]), 2, 0)
    about_x = np.moveaxis(np.array([[one, zero, zero], [zero, cp, -sp], [zero, sp, cp]]), 2, 0)
    return np.asarray(about_y @ about_x, dtype=np.float64)


def _drift(t: F64, rng: np.random.Generator, amplitude: float, slowest_hz: float) -> F64:
    """A smooth wander [N] of about ``amplitude``: three incommensurate sines of random phase, zero at t = 0."""
    out = np.zeros_like(t)
    for k, share in enumerate((0.6, 0.28, 0.12)):
        frequency, phase = slowest_hz * (1.0, 2.3, 4.9)[k], rng.uniform(0, 2 * np.pi)
        out += share * (np.sin(2 * np.pi * frequency * t + phase) - np.sin(phase))
    return amplitude * out


def _still(t: F64, rng: np.random.Generator) -> Motion:
    zero = np.zeros_like(t)
    return zero, zero + 0.12, zero, zero, zero


def _looking(t: F64, rng: np.random.Generator) -> Motion:
    yaw, pitch = _drift(t, rng, np.radians(22), 0.22), _drift(t, rng, np.radians(9), 0.17)
    return _drift(t, rng, 0.02, 0.3), 0.12 + _drift(t, rng, 0.01, 0.3), _drift(t, rng, 0.02, 0.2), yaw, pitch


def _turning(t: F64, rng: np.random.Generator) -> Motion:
    """Quick turns to either side of the scene and back, one every 0.8 to 1.6 seconds."""
    yaw, start, target = np.zeros_like(t), 0.5, 0.0
    while start < t[-1]:
        goal = np.radians(rng.uniform(-28, 28) if abs(target) > 0.1 else rng.choice((-1.0, 1.0)) * rng.uniform(30, 55))
        x = np.clip((t - start) / 0.33, 0.0, 1.0)
        yaw += (goal - target) * (10 * x**3 - 15 * x**4 + 6 * x**5)  # minimum jerk
        start, target = start + rng.uniform(0.8, 1.6), float(goal)
    zero = np.zeros_like(t)
    return zero, zero + 0.12, zero, yaw, 0.12 * np.abs(yaw)


def _walking(t: F64, rng: np.random.Generator) -> Motion:
    """An arc around the scene, nearer and farther, with the bob and sway of steps; the gaze stays about the centre."""
    step = 2 * np.pi * 1.8 * t
    height = 0.12 + 0.008 * np.abs(np.sin(step / 2)) + _drift(t, rng, 0.04, 0.05)
    arc = _drift(t, rng, 0.9, 0.06) + 0.006 * np.sin(step / 2)
    yaw = _drift(t, rng, np.radians(8), 0.25) + np.radians(0.6) * np.sin(step / 2)
    return arc, height, _drift(t, rng, 0.16, 0.07), yaw, _drift(t, rng, np.radians(4), 0.21)


def _jitter(t: F64, rng: np.random.Generator) -> Motion:
    """Standing still under a tracker's noise: white, 0.1 degrees and a thousandth of the distance."""
    noise = rng.standard_normal((5, len(t)))
    angle, shift = np.radians(0.1), 1e-3
    return shift * noise[0], 0.12 + shift * noise[1], shift * noise[2], angle * noise[3], angle * noise[4]


KINDS: dict[str, Callable[[F64, np.random.Generator], Motion]] = {
    "still": _still,
    "looking": _looking,
    "turning": _turning,
    "walking": _walking,
    "jitter": _jitter,
}
"""The kinds of synthetic motion, by name."""
