"""Batches of augmented crops. The batch of a step depends on seed and step alone, so that training can resume."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_client.restore.networks.inputs import HALF, blocks_of
from cags_common.geometry import F32
from cags_training.pairs.crops import Crops

GAIN_LOW = 0.7
"""Least brightness in augmentation; the largest keeps what is displayable."""


@dataclass(frozen=True, eq=False)
class Batch:
    """B patches of side S, float32 in [0, 1]."""

    distorted: F32  # [B, S, S, 3]
    aligned: F32  # [B, S, S, 3]
    closed_form: F32  # [B, S, S, 3]
    confidence: F32  # [B, S, S]
    truth: F32  # [B, S, S, 3]
    covered: F32  # [B, S, S]
    blocks: F32  # [B, S / 4, S / 4, 39]

    def __len__(self) -> int:
        return len(self.truth)


def draw_batch(crops: Crops, size: int, patch: int, seed: int, step: int) -> Batch:
    """``size`` patches of random crops, each turned, mirrored and recoloured at random."""
    rng = np.random.default_rng((seed, step))
    rows = rng.integers(len(crops), size=size)
    return _stacked([_augmented(_patch(crops, int(row), patch, rng), rng) for row in rows])


def plain_batch(crops: Crops, rows: NDArray[np.integer], patch: int) -> Batch:
    """The middle patches of the crops ``rows``, as they are."""
    return _stacked([_patch(crops, int(row), patch, None) for row in rows])


@dataclass(eq=False)
class _Patch:
    colours: F32  # [4 pictures, S, S, 3]: distorted, aligned, closed form, truth
    masks: F32  # [2, S, S]: confidence, covered
    features: F32  # [S / 2, S / 2, 10]
    level: np.float32


def _patch(crops: Crops, row: int, side: int, rng: np.random.Generator | None) -> _Patch:
    spare = (crops.truth.shape[1] - side) // HALF
    if spare < 0:
        raise ValueError(f"patch = {side} is larger than the crops of side {crops.truth.shape[1]}")
    y, x = (spare // 2, spare // 2) if rng is None else (int(v) for v in rng.integers(spare + 1, size=2))
    area = np.s_[row, HALF * y : HALF * y + side, HALF * x : HALF * x + side]
    colours = np.stack([crops.distorted[area], crops.aligned[area], crops.closed_form[area], crops.truth[area]])
    masks = np.stack([crops.confidence[area], crops.covered[area]])
    features = crops.features[row, y : y + side // HALF, x : x + side // HALF]
    scale = np.float32(1 / 255)
    pictures, shares = colours.astype(np.float32) * scale, masks.astype(np.float32) * scale
    return _Patch(pictures, shares, features.astype(np.float32), crops.level[row])


def _augmented(patch: _Patch, rng: np.random.Generator) -> _Patch:
    colours, masks, features = patch.colours, patch.masks, patch.features
    for axis in (0, 1):
        if rng.random() < 0.5:
            colours, masks, features = np.flip(colours, axis + 1), np.flip(masks, axis + 1), np.flip(features, axis)
    if rng.random() < 0.5:
        colours, masks, features = colours.swapaxes(1, 2), masks.swapaxes(1, 2), features.swapaxes(0, 1)
    return _recoloured(_Patch(colours, masks, features, patch.level), rng)


def _recoloured(patch: _Patch, rng: np.random.Generator) -> _Patch:
    """Channels exchanged and scaled, in all pictures and features alike: everything before the network is linear."""
    gains = (rng.uniform(GAIN_LOW, 1.0) * rng.uniform(0.8, 1.0, 3)).astype(np.float32)
    order = rng.permutation(3)
    features = np.ascontiguousarray(patch.features)
    for first in (0, 3, 6):
        features[..., first : first + 3] = features[..., first + order] * gains
    level = patch.level * gains.mean()
    return _Patch(patch.colours[..., order] * gains, np.ascontiguousarray(patch.masks), features, level)


def _stacked(patches: list[_Patch]) -> Batch:
    colours = np.stack([patch.colours for patch in patches], axis=1)
    masks = np.stack([patch.masks for patch in patches], axis=1)
    blocks = blocks_of(np.stack([p.features for p in patches]), np.array([p.level for p in patches], np.float32))
    return Batch(colours[0], colours[1], colours[2], masks[0], colours[3], masks[1], blocks)
