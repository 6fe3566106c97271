"""The random subset of a clip's splats that codebooks are trained on."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from cags_common.errors import SceneError
from cags_common.splats import Splats

LOOKS = 240
"""Number of frames sampled, evenly over the clip."""

FIRST_SHARE = 0.5
"""Share of the subset that comes from the first frame, all of whose splats every viewer sees."""


def looked_at(frames: int) -> list[int]:
    """Indices of the frames to sample in a clip of ``frames``, ascending from 0."""
    return [int(index) for index in np.unique(np.linspace(0, frames - 1, min(LOOKS, frames)).astype(int))]


def training_splats(name: str, looks: int, frames: Iterable[tuple[int, Splats]], count: int, seed: int) -> Splats:
    """At most ``count`` splats: from the first frame, and from later frames those that are not bit-identical to it.

    ``frames`` are the ``looks`` frames of :func:`looked_at` with their indices; ``name`` names the scene in errors.
    Deterministic for a seed. Raises :class:`SceneError`.
    """
    random, coming = np.random.default_rng(seed), iter(frames)
    first = next(coming)[1]
    seen, changed = _row_keys(first), []
    for index, splats in coming:
        check_degree(splats, first.sh_degree, f"{name}, frame {index}")
        fresh = np.flatnonzero(~np.isin(_row_keys(splats), seen))
        changed.append(_draw(splats.take(fresh), count // (looks - 1), random))
    later = Splats.concatenate(changed) if changed else first.take(slice(0, 0))
    base = _draw(first, max(int(count * FIRST_SHARE), count - len(later)), random)
    return Splats.concatenate([base, _draw(later, count - len(base), random)])


def check_degree(splats: Splats, degree: int, where: str) -> None:
    """Raise :class:`SceneError` naming ``where`` unless ``splats`` have this SH degree. A clip has one degree."""
    if splats.sh_degree != degree:
        raise SceneError(f"{where}: SH degree {splats.sh_degree}, but {degree} before; make the frames equal")


def _draw(splats: Splats, count: int, random: np.random.Generator) -> Splats:
    if len(splats) <= count:
        return splats
    return splats.take(np.sort(random.choice(len(splats), count, replace=False)))


def _row_keys(splats: Splats) -> np.ndarray:
    """64-bit hash of each splat's bits without its position."""
    n = len(splats)
    keys = np.zeros(n, np.uint64)
    for name, array in splats.arrays():
        if name == "means":
            continue
        for column in array.reshape(n, -1).view(np.uint32).T:
            keys = (keys ^ column.astype(np.uint64)) * np.uint64(0x9E3779B97F4A7C15)
            keys ^= keys >> np.uint64(29)
    return keys
