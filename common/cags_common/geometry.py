"""Poses, cameras and quaternions.

World frame: right-handed. Camera frame: +X right, +Y down, +Z forward (OpenCV). Pixel (i, j) has its centre at
(i + 0.5, j + 0.5). Quaternions are ``wxyz``, unit, with w >= 0. See ``docs/conventions.md``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

F32: TypeAlias = NDArray[np.float32]
F64: TypeAlias = NDArray[np.float64]
Vec3: TypeAlias = tuple[float, float, float]
Quat: TypeAlias = tuple[float, float, float, float]

DEFAULT_NEAR = 0.2
"""Near plane of the 3DGS papers, in world units (metres)."""

MAX_FOV_RAD = math.radians(179.0)
"""Widest field of view that a pinhole camera is allowed to have here."""


_BLOCK = 64
"""Points that :func:`axis_bounds` takes as one row."""


def axis_bounds(points: F32) -> tuple[F32, F32]:
    """Smallest and largest coordinate [3] an axis of ``points`` [n, 3], n >= 1; NaN on an axis that has one.

    numpy reduces rows of three numbers one by one, at ten times the cost of wide rows: so the points are folded first.
    """
    whole = len(points) // _BLOCK * _BLOCK
    folded, rest = points[:whole].reshape(-1, 3 * _BLOCK), points[whole:]
    if not whole:
        return rest.min(axis=0), rest.max(axis=0)
    low = np.concatenate([folded.min(axis=0).reshape(_BLOCK, 3), rest])
    high = np.concatenate([folded.max(axis=0).reshape(_BLOCK, 3), rest])
    return low.min(axis=0), high.max(axis=0)


def normalise_quaternion(q: Quat) -> Quat:
    """Return the unit quaternion of ``q`` with w >= 0. Raises ``ValueError`` for a zero or non-finite one."""
    norm = math.sqrt(sum(c * c for c in q))
    if not math.isfinite(norm) or norm < 1e-12:
        raise ValueError(f"quaternion {q} has no direction; give four finite numbers, not all zero")
    sign = -1.0 if q[0] < 0 else 1.0
    w, x, y, z = (sign * c / norm for c in q)
    return (w, x, y, z)


def rotation_matrix(q: Quat) -> F64:
    """Rotation matrix [3, 3] of a unit quaternion ``wxyz``."""
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_of_matrix(rotation: F64) -> Quat:
    """Unit quaternion (w >= 0) of a rotation matrix [3, 3], by its largest component (stable at 180 degrees)."""
    m = rotation
    candidates = np.array(
        [
            m[0, 0] + m[1, 1] + m[2, 2],
            m[0, 0] - m[1, 1] - m[2, 2],
            m[1, 1] - m[0, 0] - m[2, 2],
            m[2, 2] - m[0, 0] - m[1, 1],
        ]
    )
    largest = int(np.argmax(candidates))
    s = 2.0 * math.sqrt(max(1.0 + float(candidates[largest]), 1e-12))
    differences = (float(m[2, 1] - m[1, 2]), float(m[0, 2] - m[2, 0]), float(m[1, 0] - m[0, 1]))
    if largest == 0:
        q = (0.25 * s, differences[0] / s, differences[1] / s, differences[2] / s)
    else:
        i = largest - 1
        j, k = (i + 1) % 3, (i + 2) % 3
        parts = [differences[i] / s, 0.0, 0.0, 0.0]
        parts[1 + i] = 0.25 * s
        parts[1 + j] = float(m[j, i] + m[i, j]) / s
        parts[1 + k] = float(m[k, i] + m[i, k]) / s
        q = (parts[0], parts[1], parts[2], parts[3])
    return normalise_quaternion(q)


def multiply_quaternions(a: Quat, b: Quat) -> Quat:
    """Hamilton product: the rotation ``b`` followed by ``a``. Not canonicalised."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def rotation_vector(q: Quat) -> Vec3:
    """Logarithm on SO(3): axis times angle, radians, of a unit quaternion. Angle in [0, pi]; sign-safe."""
    w, x, y, z = normalise_quaternion(q)
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 if sine < 1e-12 else 2.0 * math.atan2(sine, w) / sine
    return (x * scale, y * scale, z * scale)


def quaternion_of_rotation_vector(v: Vec3) -> Quat:
    """Exponential on SO(3): unit quaternion (w >= 0) of a rotation vector in radians."""
    angle = math.sqrt(sum(c * c for c in v))
    scale = 0.5 if angle < 1e-12 else math.sin(angle / 2) / angle
    return normalise_quaternion((math.cos(angle / 2), v[0] * scale, v[1] * scale, v[2] * scale))


def angle_between(a: Quat, b: Quat) -> float:
    """Angle in radians of the rotation that takes ``a`` to ``b``; in [0, pi]."""
    conjugate = (a[0], -a[1], -a[2], -a[3])
    return math.sqrt(sum(c * c for c in rotation_vector(multiply_quaternions(conjugate, b))))


@dataclass(frozen=True, slots=True)
class Pose:
    """A rigid pose ``T_world_camera``: where the camera is and how it is turned, in the world frame.

    ``position`` is in world units (metres); ``rotation`` is a unit quaternion ``wxyz`` with w >= 0 (made so here).
    Raises ``ValueError`` for non-finite numbers.
    """

    position: Vec3
    rotation: Quat

    def __post_init__(self) -> None:
        if not all(math.isfinite(c) for c in self.position):
            raise ValueError(f"pose position {self.position} is not finite")
        object.__setattr__(self, "rotation", normalise_quaternion(self.rotation))

    @classmethod
    def identity(cls) -> Pose:
        """The camera at the origin, looking along +Z."""
        return cls((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))

    @classmethod
    def looking_at(cls, eye: Vec3, target: Vec3, up: Vec3 = (0.0, 1.0, 0.0)) -> Pose:
        """Camera at ``eye`` looking at ``target``; ``up`` is the world's up direction (image rows go against it)."""
        forward = np.subtract(target, eye)
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, up)
        if np.linalg.norm(right) < 1e-9:  # looking straight along up: any right will do
            right = np.cross(forward, (1.0, 0.0, 0.0) if abs(forward[0]) < 0.9 else (0.0, 0.0, 1.0))
        right = right / np.linalg.norm(right)
        down = np.cross(forward, right)
        return cls(eye, quaternion_of_matrix(np.stack([right, down, forward], axis=1)))

    def towards(self, other: Pose, fraction: float) -> Pose:
        """The pose ``fraction`` (0..1) of the way to ``other``: position linear, rotation on the shorter arc.

        Plain floats: one pose through arrays (:func:`cags_common.so3.slerp`) takes thirty times as long.
        """
        position = [a + (b - a) * fraction for a, b in zip(self.position, other.position, strict=True)]
        w, x, y, z = self.rotation
        turn = rotation_vector(multiply_quaternions((w, -x, -y, -z), other.rotation))
        part = quaternion_of_rotation_vector((turn[0] * fraction, turn[1] * fraction, turn[2] * fraction))
        return Pose((position[0], position[1], position[2]), multiply_quaternions(self.rotation, part))

    @property
    def rotation_matrix(self) -> F64:
        """[3, 3], camera to world."""
        return rotation_matrix(self.rotation)


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """Pinhole intrinsics in pixels; centres of pixels are at + 0.5."""

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float

    def __post_init__(self) -> None:
        if self.width_px < 1 or self.height_px < 1:
            raise ValueError(f"image size {self.width_px}x{self.height_px} px must be at least 1x1")
        for name in ("fx_px", "fy_px", "cx_px", "cy_px"):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"{name} = {getattr(self, name)} is not finite")
        if self.fx_px <= 0 or self.fy_px <= 0:
            raise ValueError(f"focal lengths {self.fx_px}, {self.fy_px} px must be positive")

    @classmethod
    def of_fov(cls, width_px: int, height_px: int, fov_x_rad: float, fov_y_rad: float) -> Intrinsics:
        """Centred pinhole of the given full angles; each must lie in (0, 179 degrees]."""
        for name, fov in (("fov_x_rad", fov_x_rad), ("fov_y_rad", fov_y_rad)):
            if not 0 < fov <= MAX_FOV_RAD:
                raise ValueError(f"{name} = {fov} must lie in (0, {MAX_FOV_RAD:.4f}]")
        fx, fy = width_px / (2 * math.tan(fov_x_rad / 2)), height_px / (2 * math.tan(fov_y_rad / 2))
        return cls(width_px, height_px, fx, fy, width_px / 2, height_px / 2)

    @property
    def fov_rad(self) -> tuple[float, float]:
        """Full horizontal and vertical angles of a centred pinhole of these focal lengths."""
        return 2 * math.atan(self.width_px / (2 * self.fx_px)), 2 * math.atan(self.height_px / (2 * self.fy_px))

    def resized(self, width_px: int, height_px: int) -> Intrinsics:
        """The same view sampled by another number of pixels."""
        sx, sy = width_px / self.width_px, height_px / self.height_px
        return Intrinsics(width_px, height_px, self.fx_px * sx, self.fy_px * sy, self.cx_px * sx, self.cy_px * sy)


@dataclass(frozen=True, slots=True)
class Camera:
    """Intrinsics, a pose ``T_world_camera`` and the near plane (world units)."""

    intrinsics: Intrinsics
    pose: Pose
    near: float = DEFAULT_NEAR

    @property
    def width_px(self) -> int:
        """Image width."""
        return self.intrinsics.width_px

    @property
    def height_px(self) -> int:
        """Image height."""
        return self.intrinsics.height_px

    @property
    def world_to_camera(self) -> tuple[F64, F64]:
        """Rotation [3, 3] and translation [3] that take world points to the camera frame."""
        rotation = self.pose.rotation_matrix.T
        return rotation, -rotation @ np.asarray(self.pose.position)

    def at(self, pose: Pose) -> Camera:
        """The same camera at another pose."""
        return replace(self, pose=pose)
