"""What every backend asks of its input before it draws it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cags_common.errors import ConfigError, SceneError
from cags_common.geometry import F32, Camera
from cags_common.splats import Splats, check_shapes

MAX_LOGIT = 20.0
"""Opacity logits are clamped to +-this: files hold infinite ones for opacities of exactly 0 and 1."""

MIN_QUATERNION_NORM = 1e-12
"""A shorter quaternion has no direction."""

MAX_SIDE_PX = 16384
"""Largest image side."""


def drawable(splats: Splats, source: str = "splats") -> Splats:
    """``splats`` as contiguous float32 that can be drawn; an empty scene is one.

    Raises :class:`SceneError` that names the attribute and the first index of a non-finite value or zero quaternion.
    Quaternions need not be unit.
    """
    arrays = {name: np.ascontiguousarray(array, dtype=np.float32) for name, array in splats.arrays()}
    check_shapes(arrays, source)
    logits = arrays["logit_opacities"]
    if logits.size and not np.abs(logits).max() <= MAX_LOGIT:
        arrays["logit_opacities"] = np.where(np.isnan(logits), logits, np.clip(logits, -MAX_LOGIT, MAX_LOGIT))
    for name, array in arrays.items():
        _check_finite(name, array, source)
    _check_directions(arrays["quats"], source)
    return Splats(**arrays)


def replacements(
    rows: NDArray[np.integer], splats: Splats, count: int, harmonics: int
) -> tuple[Splats, NDArray[np.int64]]:
    """``splats`` and ``rows`` as they replace those of a scene of ``count`` splats with ``harmonics`` a channel.

    Missing harmonics are zero. Raises ``ValueError`` for more of them than the scene has and for rows that are not one
    for each splat, ``IndexError`` for rows outside the scene, and what :func:`drawable` raises.
    """
    new, indices = drawable(splats), np.ascontiguousarray(rows, dtype=np.int64)
    if indices.shape != (len(new),):
        raise ValueError(f"{len(new)} splats for rows of shape {indices.shape}; give one row for each")
    _check_rows(indices, count)
    rest = new.sh_rest
    if rest.shape[1] > harmonics:
        raise ValueError(f"splats of SH degree {new.sh_degree} do not fit a scene with {harmonics} harmonics a channel")
    if rest.shape[1] < harmonics:
        padded = np.zeros((len(new), harmonics, 3), np.float32)
        padded[:, : rest.shape[1]] = rest
        new = replace(new, sh_rest=padded)
    return new, indices


def movement(rows: NDArray[np.integer], splats: Splats, count: int) -> tuple[NDArray[np.int64], F32]:
    """Rising ``rows`` once each, and opacity logits [N] that can be drawn, for a scene of ``count`` splats that take
    their places of ``splats`` [N]; raises as above, but for values.
    """
    indices = np.ascontiguousarray(rows, dtype=np.int64)
    if indices.ndim != 1 or len(splats) != count:
        raise ValueError(f"{len(splats)} splats for a scene of {count}; rows of shape {indices.shape}")
    if len(indices) > 1 and not (np.diff(indices) > 0).all():
        indices = np.unique(indices)
    _check_rows(indices, count)
    return indices, np.clip(splats.logit_opacities, -MAX_LOGIT, MAX_LOGIT, dtype=np.float32)


def check_camera(camera: Camera) -> None:
    """Raise :class:`ConfigError` for an image that is too large or a near plane that is not in front of the camera."""
    if max(camera.width_px, camera.height_px) > MAX_SIDE_PX:
        raise ConfigError(
            f"image of {camera.width_px}x{camera.height_px} px is too large; at most {MAX_SIDE_PX} a side"
        )
    if not 0 < camera.near < np.inf:
        raise ConfigError(f"near = {camera.near} must be positive and finite; the papers use 0.2")


def _check_rows(indices: NDArray[np.int64], count: int) -> None:
    if indices.size and (indices.min() < 0 or indices.max() >= count):
        raise IndexError(f"rows {indices.min()}..{indices.max()} do not lie in a scene of {count} splats")


def _check_directions(quats: F32, source: str) -> None:
    squares = np.einsum("nk,nk->n", quats, quats)
    if not squares.size or squares.min() > 2 * MIN_QUATERNION_NORM**2:  # small ones are wrong in single precision
        return
    norms = np.linalg.norm(quats.astype(np.float64), axis=1)
    if norms.min() < MIN_QUATERNION_NORM:
        raise SceneError(
            f"{source}: quats[{int(np.argmin(norms))}] is zero: it has no direction; give a unit quaternion"
        )


def _check_finite(name: str, array: F32, source: str) -> None:
    finite = np.isfinite(array)
    if finite.all():
        return
    index = int(np.argmax(~finite.reshape(len(array), -1).all(axis=1)))
    raise SceneError(f"{source}: {name}[{index}] = {array[index].tolist()} is not finite; repair the data")
