"""The random subset of a clip's splats that codebooks are trained on."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from cags_common.errors import SceneError
from cags_common.geometry import F32
from cags_common.splats import Splats

U64 = NDArray[np.uint64]
Mask = NDArray[np.bool_]

FRAMES = 240
"""Number of frames sampled, evenly over the clip."""

ATTRIBUTES = ("quats", "log_scales", "logit_opacities", "sh0", "sh_rest")
"""What codebooks are trained for."""

FIRST_SHARE = 0.5
"""Share of the subset that comes from the first frame, all of whose splats every viewer sees."""


def looked_at(frames: int) -> list[int]:
    """Indices of the frames to sample in a clip of ``frames``, ascending from 0."""
    return [int(index) for index in np.unique(np.linspace(0, frames - 1, min(FRAMES, frames)).astype(int))]


def training_splats(name: str, looks: int, frames: Iterable[tuple[int, Splats]], count: int, seed: int) -> Splats:
    """At most ``count`` splats: from the first frame, and from later frames those that are not bit-identical to it.

    ``frames`` are the ``looks`` frames of :func:`looked_at` with their indices; ``name`` names the scene in errors.
    Deterministic for a seed. Raises :class:`SceneError`.
    """
    random, coming = np.random.default_rng(seed), iter(frames)
    first = next(coming)[1]
    known, changed = _keys(first), [first.take(slice(0, 0))]
    for index, splats in coming:
        if splats is first:
            continue
        check_degree(splats, first.sh_degree, f"{name}, frame {index}")
        fresh = {attribute: ~np.isin(keys, known[attribute]) for attribute, keys in _keys(splats).items()}
        changed.append(splats.take(_changed(fresh, int(count * (1 - FIRST_SHARE)) // (looks - 1), random)))
    later = Splats.concatenate(changed)
    base = _rows(np.ones(len(first), np.bool_), count - len(later), random)
    return Splats.concatenate([first.take(base), later])


def check_degree(splats: Splats, degree: int, where: str) -> None:
    """Raise :class:`SceneError` naming ``where`` unless ``splats`` have this SH degree. A clip has one degree."""
    if splats.sh_degree != degree:
        raise SceneError(f"{where}: SH degree {splats.sh_degree}, but {degree} before; make the frames equal")


def _changed(fresh: Mapping[str, Mask], count: int, random: np.random.Generator) -> NDArray[np.int64]:
    """At most ``count`` rows of splats, ascending, each with an attribute that is ``fresh``.

    Every attribute gets an even share, if so many are fresh: where many splats turn and one fades, the opacities of
    that one need codes, too.
    """
    chosen = np.zeros(len(fresh[ATTRIBUTES[0]]), np.bool_)
    for mask in fresh.values():
        chosen[_rows(mask, count // len(fresh), random)] = True
    others = np.logical_or.reduce(list(fresh.values())) & ~chosen
    chosen[_rows(others, count - int(chosen.sum()), random)] = True
    return np.flatnonzero(chosen)


def _rows(mask: Mask, count: int, random: np.random.Generator) -> NDArray[np.int64]:
    """At most ``count`` rows of ``mask``, ascending."""
    rows = np.flatnonzero(mask)
    return rows if len(rows) <= count else np.sort(random.choice(rows, count, replace=False))


def _keys(splats: Splats) -> dict[str, U64]:
    """Attribute -> 64-bit hash [n] of its bits in each splat."""
    n, out = len(splats), {}
    for name in ATTRIBUTES:
        array: F32 = getattr(splats, name)
        keys = np.zeros(n, np.uint64)
        for column in array.reshape(n, -1).view(np.uint32).T if array.size else ():
            keys = (keys ^ column.astype(np.uint64)) * np.uint64(0x9E3779B97F4A7C15)
            keys ^= keys >> np.uint64(29)
        out[name] = keys
    return out
