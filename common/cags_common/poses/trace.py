"""Head-motion traces: read, resample, and place them so that the walk looks at a scene.

A :class:`PoseTrace` holds poses ``T_world_camera`` (camera +X right, +Y down, +Z forward) over time. Files are strict
CSV, ``time_s,px,py,pz,qw,qx,qy,qz``, in the headset convention of OpenXR (+X right, +Y up, -Z forward) unless said
otherwise: in all recorded walks of EyeNavGS people walk towards -Z of the recorded rotation, and look slightly down.
"""

from __future__ import annotations

import csv
import math
from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cags_common import so3
from cags_common.errors import TraceError
from cags_common.geometry import F64, Pose, Quat, Vec3, quaternion_of_matrix

COLUMNS = ("time_s", "px", "py", "pz", "qw", "qx", "qy", "qz")
AXES = ("openxr", "opencv")
MAX_SAMPLES = 2_000_000
"""Bound on a trace: 15 hours at 36 Hz."""

MAX_DURATION_S = 1e8
"""Three years: beyond, times are in another unit, or damaged, and would not fit microseconds."""

MAX_POSITION_M = 1e6
"""A thousand kilometres: beyond, positions are in another unit, or damaged, and their squares soon overflow."""

MIN_QUATERNION_NORM, MAX_QUATERNION_NORM = 0.9, 1.1
"""A recorded quaternion further from unit length than this is damage, not rounding."""


@dataclass(frozen=True, slots=True)
class Focus:
    """What a walk should look at: a sphere in the scene's world frame, and the direction against gravity."""

    centre: Vec3
    radius: float
    up: Vec3 = (0.0, 1.0, 0.0)

    def __post_init__(self) -> None:
        if not all(math.isfinite(c) for c in (*self.centre, self.radius, *self.up)) or self.radius <= 0:
            raise ValueError(f"focus at {self.centre} with radius {self.radius} must be finite and of positive radius")
        if math.hypot(*self.up) < 1e-9:
            raise ValueError(f"up = {self.up} has no direction")


@dataclass(frozen=True, eq=False)
class PoseTrace:
    """Poses ``T_world_camera`` at strictly rising times that start at zero."""

    times_us: NDArray[np.int64]  # [N] microseconds
    positions: F64  # [N, 3] world
    rotations: F64  # [N, 4] unit quaternions wxyz; neighbours lie on the same side, so w may be negative

    def __post_init__(self) -> None:
        n = len(self.times_us)
        if n == 0 or self.positions.shape != (n, 3) or self.rotations.shape != (n, 4):
            raise ValueError(f"trace of {n} times, positions {self.positions.shape}, rotations {self.rotations.shape}")
        if self.times_us[0] != 0 or (np.diff(self.times_us) <= 0).any():
            raise ValueError("times of a trace must start at 0 and rise strictly")
        object.__setattr__(self, "rotations", _one_side(self.rotations))

    def __len__(self) -> int:
        return len(self.times_us)

    @property
    def duration_us(self) -> int:
        """Time of the last sample."""
        return int(self.times_us[-1])

    @property
    def matrices(self) -> F64:
        """[N, 3, 3] rotations, camera to world."""
        return so3.matrices(self.rotations)

    def pose_at(self, t_us: int) -> Pose:
        """The pose at a time: positions linear, rotations by slerp. Past the end the walk goes back the way it came."""
        if len(self) == 1:
            return self._pose(0)
        folded = abs(t_us) % (2 * self.duration_us)
        folded = min(folded, 2 * self.duration_us - folded)
        after = min(max(bisect_right(self.times_us, folded), 1), len(self) - 1)
        start, end = int(self.times_us[after - 1]), int(self.times_us[after])
        return self._pose(after - 1).towards(self._pose(after), (folded - start) / (end - start))

    def _pose(self, at: int) -> Pose:
        return Pose(_vec3(self.positions[at]), _quat(self.rotations[at]))

    def poses_at(self, times_us: Iterable[int]) -> list[Pose]:
        """:meth:`pose_at` for many times."""
        return self._poses_at(np.fromiter(times_us, dtype=np.int64))

    def window(self, start_us: int, end_us: int) -> PoseTrace:
        """The samples in ``[start_us, end_us]``, with times from zero. Raises ``ValueError`` where there are none."""
        inside = (self.times_us >= start_us) & (self.times_us <= end_us)
        if not inside.any():
            raise ValueError(f"the trace has no sample between {start_us} and {end_us} us")
        times = self.times_us[inside]
        return PoseTrace(times - times[0], self.positions[inside], self.rotations[inside])

    def moved(self, rotation: F64, scale: float, origin: F64, target: F64) -> PoseTrace:
        """Similarity move: ``x -> target + scale * rotation @ (x - origin)``; the camera turns by ``rotation``."""
        positions = target + scale * (self.positions - origin) @ rotation.T
        turned = so3.multiply(np.asarray(quaternion_of_matrix(rotation)), self.rotations)
        return PoseTrace(self.times_us, positions, turned)

    def beginning_at(self, pose: Pose) -> PoseTrace:
        """The same walk, moved rigidly so that its first pose is ``pose``."""
        rotation = np.asarray(pose.rotation_matrix @ self.matrices[0].T, dtype=np.float64)
        return self.moved(rotation, 1.0, self.positions[0], np.asarray(pose.position))

    def _poses_at(self, times_us: NDArray[np.int64]) -> list[Pose]:
        positions, rotations = self._sample(times_us)
        return [Pose(_vec3(p), _quat(q)) for p, q in zip(positions, rotations, strict=True)]

    def _sample(self, times_us: NDArray[np.int64]) -> tuple[F64, F64]:
        if len(self) == 1:
            return (
                np.repeat(self.positions, len(times_us), axis=0),
                np.repeat(self.rotations, len(times_us), axis=0),
            )
        folded = np.abs(times_us) % (2 * self.duration_us)
        folded = np.where(folded > self.duration_us, 2 * self.duration_us - folded, folded)
        after = np.clip(np.searchsorted(self.times_us, folded, side="right"), 1, len(self) - 1)
        before = after - 1
        span = (self.times_us[after] - self.times_us[before]).astype(np.float64)
        f = ((folded - self.times_us[before]) / span)[:, None]
        positions = self.positions[before] * (1 - f) + self.positions[after] * f
        return positions, so3.slerp(self.rotations[before], self.rotations[after], f[:, 0])


def read_poses(path: str | Path, axes: str = "openxr") -> PoseTrace:
    """Read a CSV pose trace. ``axes`` says how the file's rotations look out: ``openxr`` or ``opencv``.

    Raises :class:`TraceError` for a missing or malformed file, naming the line.
    """
    if axes not in AXES:
        raise TraceError(f"{path}: axes {axes!r} are unknown; known: {', '.join(AXES)}")
    try:
        with Path(path).open(newline="", encoding="utf-8") as file:
            rows = _read_rows(str(path), file)
    except OSError as error:
        raise TraceError(f"{path}: cannot be read ({error.strerror}); give a pose trace (.csv)") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise TraceError(f"{path}: is not a CSV text ({error})") from error
    rotations = rows[:, 4:] / np.linalg.norm(rows[:, 4:], axis=1, keepdims=True)
    if axes == "openxr":  # half a turn about the camera's X takes (up, backward) to (down, forward)
        rotations = so3.multiply(rotations, np.array([0.0, 1.0, 0.0, 0.0]))
    seconds = rows[:, 0] - rows[0, 0]
    if not seconds[-1] <= MAX_DURATION_S:
        raise TraceError(f"{path}: lasts {seconds[-1]:g} s, more than {MAX_DURATION_S:g} s; give times in seconds")
    times_us = np.round(seconds * 1e6).astype(np.int64)
    if (np.diff(times_us) <= 0).any():
        raise TraceError(f"{path}: two samples lie less than a microsecond apart")
    return PoseTrace(times_us, rows[:, 1:4].copy(), rotations)


def write_poses(trace: PoseTrace, path: str | Path) -> None:
    """Write a trace in the file format of :func:`read_poses` (OpenXR axes)."""
    rotations = so3.multiply(trace.rotations, np.array([0.0, -1.0, 0.0, 0.0]))
    with Path(path).open("w", newline="", encoding="utf-8") as file:
        file.write(",".join(COLUMNS) + "\n")
        for t, p, q in zip(trace.times_us, trace.positions, rotations, strict=True):
            file.write(",".join([f"{t / 1e6:.6f}", *(f"{v:.6f}" for v in p), *(f"{v:.9f}" for v in q)]) + "\n")


def _read_rows(name: str, lines: Iterable[str]) -> F64:
    reader = csv.reader(lines)
    header = next(reader, None)
    if header is None:
        raise TraceError(f"{name}: is empty; the first line must be {','.join(COLUMNS)}")
    if tuple(cell.strip() for cell in header) != COLUMNS:
        raise TraceError(f"{name}: line 1 is {','.join(header)[:80]!r}; it must be {','.join(COLUMNS)}")
    rows: list[list[float]] = []
    for cells in reader:
        rows.append(_row(f"{name}: line {reader.line_num}", cells))
        if len(rows) > MAX_SAMPLES:
            raise TraceError(f"{name}: holds more than {MAX_SAMPLES} samples; cut it")
        if len(rows) > 1 and rows[-1][0] <= rows[-2][0]:
            raise TraceError(f"{name}: line {reader.line_num}: time {cells[0]} s is not after the one before")
    if not rows:
        raise TraceError(f"{name}: holds no samples")
    return np.asarray(rows, dtype=np.float64)


def _row(where: str, cells: list[str]) -> list[float]:
    if len(cells) != len(COLUMNS):
        raise TraceError(f"{where}: has {len(cells)} columns, expected {len(COLUMNS)}")
    try:
        values = [float(cell) for cell in cells]
    except ValueError as error:
        raise TraceError(f"{where}: {error}") from error
    if not all(math.isfinite(v) for v in values):
        raise TraceError(f"{where}: holds a number that is not finite")
    far = max(values[1:4], key=abs)
    if abs(far) > MAX_POSITION_M:
        raise TraceError(f"{where}: position {far:g} is beyond {MAX_POSITION_M:g}; give positions in metres")
    norm = math.hypot(*values[4:])
    if not MIN_QUATERNION_NORM <= norm <= MAX_QUATERNION_NORM:
        raise TraceError(f"{where}: quaternion of length {norm:.4f}, expected 1")
    return values


def _one_side(q: F64) -> F64:
    """Unit quaternions with signs such that neighbours lie within 90 degrees of each other on the 3-sphere."""
    unit = q / np.linalg.norm(q, axis=1, keepdims=True)
    steps = np.where((unit[1:] * unit[:-1]).sum(axis=1) < 0, -1.0, 1.0)
    return np.asarray(unit * np.concatenate([[1.0], np.cumprod(steps)])[:, None], dtype=np.float64)


def _vec3(v: F64) -> Vec3:
    return (float(v[0]), float(v[1]), float(v[2]))


def _quat(q: F64) -> Quat:
    return (float(q[0]), float(q[1]), float(q[2]), float(q[3]))
