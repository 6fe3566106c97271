"""What every backend asks of its input before it draws it."""

from __future__ import annotations

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


def change(rows: NDArray[np.integer], splats: Splats, held: tuple[int, int]) -> tuple[NDArray[np.int64], F32]:
    """Rising ``rows`` once each, and opacity logits [N] that can be drawn, for a scene that takes them from ``splats``
    [N]; ``held``: its splats, and their harmonics a channel.

    Raises ``ValueError`` for splats that are not the scene's and ``IndexError`` for rows outside it.
    """
    indices, (count, harmonics) = np.ascontiguousarray(rows, dtype=np.int64), held
    if indices.ndim != 1 or len(splats) != count:
        raise ValueError(f"{len(splats)} splats for a scene of {count}; rows of shape {indices.shape}")
    if splats.sh_rest.shape[1] != harmonics:
        raise ValueError(f"splats of SH degree {splats.sh_degree} for a scene with {harmonics} harmonics a channel")
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
