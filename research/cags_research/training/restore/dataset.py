"""Batches of augmented crops. The batch of a step depends on seed and step alone, so that training can resume."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32, F64
from cags_research.training.pairs.crops import Crops


@dataclass(frozen=True, eq=False)
class Batch:
    """B patches of side S of clients' views; float32, in [0, 1]."""

    distorted: F32  # [B, S, S, 3]
    aligned: F32  # [B, S, S, 3]
    confidence: F32  # [B, S, S, 1]
    truth: F32  # [B, S, S, 3]
    covered: F32  # [B, S, S, 1]
    expected_db: F32  # [B, 1, 1, 1] PSNR expected of the views that the patches are from


CLASSES_DB = (24.0, 28.0, 32.0, 36.0, 40.0, 45.0)
"""Bounds of the classes of crops, by the PSNR of the distorted picture."""


def even_chances(crops: Crops) -> F64:
    """Chance of each crop [N], so that every class of :data:`CLASSES_DB` that there is comes as often as the others.

    Drawn evenly, most crops would be nearly perfect: a network does best to learn to leave them alone. Within a class,
    crops are classed by the aligned reference, and each class counts by the root of its size: a reference that is far
    off in a few places (colours that change with the view) is rare, and costs a whole picture more than all the rest.
    """
    own, aligned = (np.digitize(psnr_db, CLASSES_DB) for psnr_db in (distorted_psnr(crops), aligned_psnr(crops)))
    both = own * (len(CLASSES_DB) + 1) + aligned
    sizes = np.bincount(both)
    weights = 1.0 / np.sqrt(sizes[both])
    of_class = np.bincount(own, weights=weights)
    chances: F64 = weights / (of_class[own] * np.count_nonzero(of_class))
    return chances


def distorted_psnr(crops: Crops) -> F64:
    """PSNR of the distorted pictures [N] in dB over covered pixels, at most 60."""
    return np.array([_psnr(crops, crops.distorted[row], row) for row in range(len(crops))])


def aligned_psnr(crops: Crops) -> F64:
    """The same of the aligned references [N]."""
    return np.array([_psnr(crops, crops.aligned[row], row) for row in range(len(crops))])


def _psnr(crops: Crops, picture: NDArray[np.uint8], row: int) -> float:
    covered = crops.covered[row] >= 128
    off = (picture[covered].astype(np.float64) - crops.truth[row][covered]) / 255
    return -10 * float(np.log10(max(np.mean(off**2), 1e-6))) if covered.any() else 60.0


def draw_batch(crops: Crops, size: int, patch: int, at: tuple[int, int], chances: F64 | None = None) -> Batch:
    """``size`` patches of random crops, each turned and mirrored at random, at seed and step ``at``.

    ``chances`` [N] are those of the crops; None: equal.
    """
    rng = np.random.default_rng(at)
    rows = rng.choice(len(crops), size=size, p=chances)
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
        expected_db=crops.expected_db[row].reshape(1, 1, 1),
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
