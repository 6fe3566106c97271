"""Batches of augmented crops. The batch of a step depends on seed and step alone, so that training can resume."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_client.restore.networks.inputs import noise_features
from cags_common.geometry import F32
from cags_training.pairs.crops import POSITION_PX, Crops


@dataclass(frozen=True, eq=False)
class Batch:
    """B patches of side S of clients' pictures, and of side R of their references; float32, pictures in [0, 1]."""

    distorted: F32  # [B, S, S, 3]
    aligned: F32  # [B, S, S, 3]
    closed_form: F32  # [B, S, S, 3]
    truth: F32  # [B, S, S, 3]
    confidence: F32  # [B, S, S, 1]
    covered: F32  # [B, S, S, 1]
    weight: F32  # [B, S, S, 1]
    places: F32  # [B, S, S, 2] x and y in the patch of the reference, shares of its side
    own: F32  # [B, R, R, 3]
    reference: F32  # [B, R, R, 3]
    clean: F32  # [B, R, R, 3]
    fields: F32  # [B, R, R, 4]
    noise: F32  # [B, 1, 1, 6] as networks take it


_PICTURES = ("distorted", "aligned", "closed_form", "truth")
_MASKS = ("confidence", "covered", "weight")
_THERE = ("own", "reference", "clean")


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
    places = np.stack([crops.x[area], crops.y[area]], axis=2) * np.float32(POSITION_PX / crops.own.shape[1])
    pictures = {name: _as_float(getattr(crops, name)[area]) for name in _PICTURES}
    masks = {name: _as_float(getattr(crops, name)[area])[..., None] for name in _MASKS}
    there = {name: _as_float(getattr(crops, name)[row]) for name in _THERE}
    fields, noise = crops.fields[row].astype(np.float32), noise_features(crops.noise[row])[None, None]
    return Batch(**pictures, **masks, **there, places=np.asarray(places, np.float32), fields=fields, noise=noise)


def _turned(patch: Batch, rng: np.random.Generator) -> Batch:
    images: dict[str, F32] = dict(vars(patch))
    for axis in (0, 1):
        if rng.random() < 0.5:
            images = {name: np.flip(image, axis) for name, image in images.items()}
            places = images["places"].copy()
            places[..., 1 - axis] = 1 - places[..., 1 - axis]
            images["places"] = places
    if rng.random() < 0.5:
        images = {name: image.swapaxes(0, 1) for name, image in images.items()}
        images["places"] = images["places"][..., ::-1]
    return Batch(**images)  # the noise, of one pixel, is the same from every side


def _stacked(patches: list[Batch]) -> Batch:
    return Batch(*(np.stack(images) for images in zip(*(vars(p).values() for p in patches), strict=True)))


def _as_float(image: NDArray[np.uint8]) -> F32:
    return image.astype(np.float32) * np.float32(1 / 255)
