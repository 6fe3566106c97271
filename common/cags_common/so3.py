"""Rotations in bulk: the group operations of SO(3) on arrays of unit quaternions ``wxyz`` [..., 4]."""

from __future__ import annotations

import numpy as np

from cags_common.geometry import F64


def multiply(a: F64, b: F64) -> F64:
    """Hamilton product, broadcasting: the rotation ``b`` followed by ``a``."""
    aw, ax, ay, az = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bw, bx, by, bz = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    w = aw * bw - ax * bx - ay * by - az * bz
    out = np.empty((*np.shape(w), 4))
    out[..., 0] = w
    out[..., 1] = aw * bx + ax * bw + ay * bz - az * by
    out[..., 2] = aw * by - ax * bz + ay * bw + az * bx
    out[..., 3] = aw * bz + ax * by - ay * bx + az * bw
    return out


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
    u, w = q[..., 1:], q[..., :1]
    cross = _cross(u, v) + w * v
    return np.asarray(v + 2.0 * _cross(u, cross))


def _cross(a: F64, b: F64) -> F64:
    """Cross product along the last axis (np.cross spends most of its time on finding its axes)."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    x = ay * bz - az * by
    out = np.empty((*np.shape(x), 3))
    out[..., 0], out[..., 1], out[..., 2] = x, az * bx - ax * bz, ax * by - ay * bx
    return out


def slerp(a: F64, b: F64, fraction: F64) -> F64:
    """Unit quaternions on the shorter arc from ``a`` [N, 4] to ``b`` [N, 4] at ``fraction`` [N] in [0, 1]."""
    return multiply(a, exp(log(multiply(conjugate(a), b)) * fraction[:, None]))


def matrices(q: F64) -> F64:
    """Rotation matrices [..., 3, 3] of unit quaternions [..., 4]."""
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
