"""Reads untrusted files: every failure becomes a one-line :class:`SceneError` that names the file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cags_common.errors import SceneError
from cags_common.geometry import F32, F64
from cags_common.splats import MAX_SPLATS

MAX_FILE_BYTES = 8 << 30
"""Largest scene file accepted: 20 million splats of SH degree 3 as double-precision PLY."""

MIN_SCALE = 1e-9
"""Smaller standard deviations (world units), including zero, are raised to this, so that their logarithm is finite."""

quietly = np.errstate(all="ignore")
"""Decorator for parsers: absurd values become infinite or NaN without a warning, and the final check reports them."""

MIN_OPACITY = 1e-6
"""Quantised opacities are kept this far from 0 and 1, so that their logit stays finite (13.8)."""


def read_file(path: Path, max_bytes: int = MAX_FILE_BYTES) -> bytes:
    """The bytes of ``path``. Raises :class:`SceneError` for missing, unreadable, empty and oversized files."""
    try:
        with path.open("rb") as file:
            size = path.stat().st_size
            if size > max_bytes:
                raise SceneError(f"{path}: is {size} bytes long; the limit is {max_bytes}")
            data = file.read(max_bytes + 1)
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror}); give an existing scene file") from error
    if not data:
        raise SceneError(f"{path}: is empty; give a file that holds splats")
    if len(data) > max_bytes:
        raise SceneError(f"{path}: is longer than {max_bytes} bytes; give a smaller file")
    return data


def check_count(count: int, source: str) -> int:
    """Return ``count`` if a file may hold that many splats. Raises :class:`SceneError`."""
    if count < 1:
        raise SceneError(f"{source}: holds no splats; give a file with at least one")
    if count > MAX_SPLATS:
        raise SceneError(f"{source}: claims {count} splats; the limit is {MAX_SPLATS}")
    return count


def log_of_scales(scales: NDArray[np.floating[Any]]) -> F32:
    """Natural logarithm of linear scales. Zero and less become :data:`MIN_SCALE`; NaN is left for the final check."""
    logarithms: F32 = np.log(np.maximum(scales, np.float32(MIN_SCALE))).astype(np.float32)
    return logarithms


def logit_of_bytes(alpha: NDArray[np.uint8]) -> F32:
    """Logits of opacities stored as bytes (0 means 0, 255 means 1)."""
    p = np.clip(np.arange(256) / 255.0, MIN_OPACITY, 1.0 - MIN_OPACITY)
    table: F32 = np.log(p / (1.0 - p)).astype(np.float32)
    return table[alpha]


def smallest_three(largest: NDArray[np.integer[Any]], others: NDArray[np.floating[Any]]) -> F32:
    """Unit quaternions [N, 4] from the index [N] of the largest component and the three ``others`` [N, 3] in order."""
    n = len(largest)
    rows = np.arange(n)
    slots = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])[largest]
    quats = np.zeros((n, 4), np.float32)
    np.put_along_axis(quats, slots, others.astype(np.float32), axis=1)
    quats[rows, largest] = np.sqrt(np.maximum(0.0, 1.0 - np.sum(np.square(others, dtype=np.float64), axis=1)))
    return quats


def directed(quats: F32) -> F32:
    """``quats`` [N, 4]; those too short to have a direction (a quantised zero) become the identity."""
    short = np.sum(np.square(quats), axis=1) < 1e-12
    if short.any():
        quats = quats.copy()
        quats[short] = (1.0, 0.0, 0.0, 0.0)
    return quats


def split_largest(quats: F32) -> tuple[NDArray[np.intp], F64]:
    """Inverse of :func:`smallest_three`: index [N] of the largest component (made positive) and the others [N, 3]."""
    wide = quats.astype(np.float64)
    largest = np.argmax(np.abs(wide), axis=1)
    rows = np.arange(len(wide))
    wide = wide * np.where(wide[rows, largest] < 0, -1.0, 1.0)[:, None]
    slots = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])[largest]
    return largest, np.take_along_axis(wide, slots, axis=1)


def bytes_of_logits(logits: F32) -> NDArray[np.uint8]:
    """Opacities as the nearest byte (0/255 .. 255/255)."""
    wide = np.clip(logits.astype(np.float64), -30.0, 30.0)
    return np.round(255.0 / (1.0 + np.exp(-wide))).astype(np.uint8)
