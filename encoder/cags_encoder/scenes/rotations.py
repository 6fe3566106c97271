"""Quaternions and rotation matrices of many splats at once."""

from __future__ import annotations

import numpy as np

from cags_common import so3
from cags_common.geometry import F32, F64


def about(axis: F64, angles: F64) -> F64:
    """Quaternions [..., 4] of rotations by ``angles`` [...] radians about a unit ``axis`` [3] or [..., 3]."""
    half = np.asarray(angles)[..., None] / 2
    return np.concatenate([np.cos(half), np.sin(half) * axis], axis=-1)


def of_frames(tangent: F64, bitangent: F64) -> F64:
    """Quaternions [N, 4] with x axis along ``tangent`` and y axis along ``bitangent``, made perpendicular to it."""
    x = _unit(tangent)
    z = _unit(np.cross(x, bitangent))
    return of_matrices(np.stack([x, np.cross(z, x), z], axis=-1))


def of_matrices(rotations: F64) -> F64:
    """Unit quaternions [N, 4] (w >= 0) of rotation matrices [N, 3, 3], stable at any angle.

    The eigenvector of the largest eigenvalue of Bar-Itzhack's symmetric 4x4 matrix (2000).
    """
    m = rotations
    trace = np.trace(m, axis1=-2, axis2=-1)
    k = np.empty((*m.shape[:-2], 4, 4))
    k[..., 0, 0] = trace
    k[..., 1:, 1:] = m + np.swapaxes(m, -1, -2) - trace[..., None, None] * np.eye(3)
    skew = np.stack([m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]], axis=-1)
    k[..., 0, 1:] = k[..., 1:, 0] = skew
    quats: F64 = np.linalg.eigh(k)[1][..., -1]
    canonical: F64 = np.where(quats[..., :1] < 0, -quats, quats)
    return canonical


def turned(quats: F32, by: F64) -> F32:
    """Splat rotations ``quats`` [N, 4] rotated by unit quaternions ``by`` [N, 4] or [4]; unit with w >= 0."""
    out = so3.multiply(by, quats.astype(np.float64))
    out *= np.where(out[:, :1] < 0, -1.0, 1.0) / np.linalg.norm(out, axis=1, keepdims=True)
    return out.astype(np.float32)


def _unit(vectors: F64) -> F64:
    units: F64 = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
    return units
