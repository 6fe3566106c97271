"""Batches of augmented crops. The batch of a step depends on seed and step alone, so that training can resume."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32
from cags_research.training.pairs.crops import Crops


@dataclass(frozen=True, eq=False)
class Batch:
    """B patches of side S of clients' views; float32, in [0, 1]."""

    distorted: F32  # [B, S, S, 3]
    aligned: F32  # [B, S, S, 3]
    confidence: F32  # [B, S, S, 1]
    truth: F32  # [B, S, S, 3]
    covered: F32  # [B, S, S, 1]


def draw_batch(crops: Crops, size: int, patch: int, seed: int, step: int) -> Batch:
    """``size`` patches of random crops, each turned and mirrored at random."""
    rng = np.random.default_rng((seed, step))
    rows = rng.integers(len(crops), size=size)
    return _stacked([_turned(_patch(crops, int(row), patch, rng), rng) for row in rows])


def plain_batch(crops: Crops, rows: NDArray[np.integer], patch: int) -> Batch:
    """The middle patches of the crops ``rows``, as they are."""
    return _stacked([_patch(crops, int(row), patch, None) for row in rows])


def _patch(crops: Crops, row: int, side: int, rng: np.random.Generator | None) -> Batch:
    """One patch: a batch without its first axis."""
    spare = crops.truth.shape[1] - side
    if spare < 0:
        raise ValueError(f"patch = {side} is larger than the crops of side {crops.truth.shape[1]}")
    y, x = (spare // 2, spare // 2) if rng is None else (int(v) for v in rng.integers(spare + 1, size=2))
    area = np.s_[row, y : y + side, x : x + side]
    return Batch(
        distorted=_as_float(crops.distorted[area]),
        aligned=_as_float(crops.aligned[area]),
        confidence=_as_float(crops.confidence[area])[..., None],
        truth=_as_float(crops.truth[area]),
        covered=_as_float(crops.covered[area])[..., None],
    )


def _turned(patch: Batch, rng: np.random.Generator) -> Batch:
    images: dict[str, F32] = dict(vars(patch))
    for axis in (0, 1):
        if rng.random() < 0.5:
            images = {name: np.flip(image, axis) for name, image in images.items()}
    if rng.random() < 0.5:
        images = {name: image.swapaxes(0, 1) for name, image in images.items()}
    return Batch(**images)


def _stacked(patches: list[Batch]) -> Batch:
    return Batch(*(np.stack(images) for images in zip(*(vars(p).values() for p in patches), strict=True)))


def _as_float(image: NDArray[np.uint8]) -> F32:
    return image.astype(np.float32) * np.float32(1 / 255)
