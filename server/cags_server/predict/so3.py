"""Rotations in bulk: the group operations of SO(3) on arrays of unit quaternions ``wxyz`` [..., 4]."""

from __future__ import annotations

import numpy as np

from cags_common.geometry import F64


def multiply(a: F64, b: F64) -> F64:
    """Hamilton product, broadcasting: the rotation ``b`` followed by ``a``."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def conjugate(q: F64) -> F64:
    """The inverse rotations."""
    return np.asarray(q * np.array([1.0, -1.0, -1.0, -1.0]))


def log(q: F64) -> F64:
    """Rotation vectors [..., 3], radians, angle in [0, pi], of unit quaternions of either sign."""
    q = np.where(q[..., :1] < 0, -q, q)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    small = sine < 1e-12
    scale = np.where(small, 2.0, 2.0 * np.arctan2(sine, q[..., :1]) / np.where(small, 1.0, sine))
    return np.asarray(q[..., 1:] * scale)


def exp(v: F64) -> F64:
    """Unit quaternions [..., 4] (w >= 0 up to half a turn) of rotation vectors [..., 3] in radians."""
    angle = np.linalg.norm(v, axis=-1, keepdims=True)
    small = angle < 1e-12
    scale = np.where(small, 0.5, np.sin(angle / 2) / np.where(small, 1.0, angle))
    return np.concatenate([np.cos(angle / 2), v * scale], axis=-1)


def rotate(q: F64, v: F64) -> F64:
    """Vectors [..., 3] turned by unit quaternions [..., 4]."""
    u = q[..., 1:]
    cross = np.cross(u, v) + q[..., :1] * v
    return np.asarray(v + 2.0 * np.cross(u, cross))


def slerp(a: F64, b: F64, fraction: F64) -> F64:
    """Unit quaternions on the shorter arc from ``a`` [N, 4] to ``b`` [N, 4] at ``fraction`` [N] in [0, 1]."""
    return multiply(a, exp(log(multiply(conjugate(a), b)) * fraction[:, None]))
