"""What networks see of a frame, made with NumPy and OpenCV.

Like is compared with like: the reference is set against the client's own splats, seen from the reference's pose through
the client's footprint (``RestoreInput.own``). The difference is *evidence* of wrong colour, free of parallax and of
pixel sizes; it is sampled at the client's pixels, at half their resolution, where nothing of it is lost.
"""

from __future__ import annotations

import cv2
import numpy as np

import cags_kernels
from cags_client.align.fast import sample
from cags_client.restore.affine import average_down
from cags_client.restore.base import RestoreInput
from cags_common.geometry import F32

HALF = 2
"""Client pixels a side of the cells that ``lite`` looks at."""

MULTIPLE_PX = 8
"""Sides are padded to a multiple of this: the coarsest resolution inside ``lite``."""

CHANNELS = 10
"""Distorted RGB, evidence RGB, change of the closed form RGB, confidence."""

BLOCK_CHANNELS = 4 * (CHANNELS - 1) + 3
"""Four cells of colours, evidence and change; then mean confidence, mean size of the change, and the frame's."""

CONFIDENCE, POWER, LEVEL = range(BLOCK_CHANNELS - 3, BLOCK_CHANNELS)
"""Places of the last three."""

_REACH_CELLS = 5


def half_features(inputs: RestoreInput, closed_form: F32) -> F32:
    """What ``lite`` looks at [h, w, 10] at half resolution, h and w multiples of 4.

    The picture is padded by its edges. ``closed_form`` [H, W, 3] is what ``affine`` makes of the same inputs.
    """
    aligned = inputs.aligned
    distorted, sure = padded(inputs.distorted), padded(aligned.confidence, zero=True)
    h, w = distorted.shape[0] // HALF, distorted.shape[1] // HALF
    x, y = (padded(c)[::HALF, ::HALF] for c in (aligned.x, aligned.y))
    out = np.empty((h, w, CHANNELS), np.float32)
    out[..., :3] = _area(distorted, w, h)
    out[..., 3:6] = sample(_evidence(inputs), x, y)
    out[..., 3:6] *= (sure[::HALF, ::HALF] > 0)[..., None]
    out[..., 6:9] = _area(padded(closed_form), w, h) - out[..., :3]
    out[..., 9] = _area(sure, w, h)
    return out


def lite_blocks(inputs: RestoreInput, closed_form: F32, threads: int = 1) -> F32:
    """Input of ``lite`` [h / 2, w / 2, 39]: blocks of 2 x 2 of :func:`half_features`, and the frame's level."""
    if inputs.own is not None and cags_kernels.native_available():
        blocks = _by_kernels(inputs, inputs.own.rgb, closed_form, threads)
        blocks[..., LEVEL] = _level(blocks)
        return blocks
    features = half_features(inputs, closed_form)
    return blocks_of(features, level_of(features))


def level_of(features: F32) -> np.float32:
    """How much the closed form changes where the reference says something: mean over the frame, in display range."""
    return _level(blocks_of(features, np.float32(0)))


def _level(blocks: F32) -> np.float32:
    sure = blocks[..., CONFIDENCE]
    return np.float32((blocks[..., POWER] * sure).sum(dtype=np.float64) / max(float(sure.sum(dtype=np.float64)), 1.0))


def blocks_of(features: F32, level: F32 | np.float32) -> F32:
    """Blocks [..., h / 2, w / 2, 39] of ``features`` [..., h, w, 10]; ``level`` [...] is the frame's."""
    *batch, h, w, _ = features.shape
    cells = features.reshape(*batch, h // 2, 2, w // 2, 2, CHANNELS).swapaxes(-4, -3)
    cells = cells.reshape(*batch, h // 2, w // 2, 4, CHANNELS)
    out = np.empty((*batch, h // 2, w // 2, BLOCK_CHANNELS), np.float32)
    out[..., :CONFIDENCE] = cells[..., :-1].reshape(*out.shape[:-1], CONFIDENCE)
    out[..., CONFIDENCE] = cells[..., -1].mean(axis=-1)
    out[..., POWER] = np.abs(cells[..., 6:9]).mean(axis=(-2, -1))
    out[..., LEVEL] = np.asarray(level)[..., None, None]
    return out


def _by_kernels(inputs: RestoreInput, own: F32, closed_form: F32, threads: int) -> F32:
    from cags_kernels import align as kernels

    aligned = inputs.aligned
    return kernels.features(
        own,
        inputs.reference.rgb,
        kernels.Reprojection(aligned.geometry.depth, *aligned.geometry.matrix),
        distorted=inputs.distorted,
        restored=closed_form,
        confidence=aligned.confidence,
        threads=threads,
    )


def plus_change(picture: F32, change: F32, threads: int = 1) -> F32:
    """``picture`` [H, W, 3] plus ``change`` in blocks [h / 2, w / 2, 12], brought up bilinearly; in [0, 1]."""
    if cags_kernels.native_available():
        from cags_kernels import align as kernels

        return kernels.add(picture, change, threads=threads)
    h, w = change.shape[:2]
    half = change.reshape(h, w, 2, 2, 3).swapaxes(1, 2).reshape(2 * h, 2 * w, 3)
    restored = cv2.resize(half, (2 * HALF * w, 2 * HALF * h), interpolation=cv2.INTER_LINEAR)[
        : picture.shape[0], : picture.shape[1]
    ]
    return np.asarray(np.clip(restored + picture, 0.0, 1.0), dtype=np.float32)


def _evidence(inputs: RestoreInput) -> F32:
    """What the reference shows minus what the client's splats show there, [H, W, 3] of the reference."""
    aligned, reference = inputs.aligned, inputs.reference.rgb
    if inputs.own is None:
        own = average_down(inputs.distorted, aligned.x, aligned.y, aligned.confidence, reference)
    else:
        own = np.clip(inputs.own.rgb, 0.0, 1.0)
    return np.asarray(reference - own, dtype=np.float32)


def filled(aligned: F32, confidence: F32, distorted: F32) -> F32:
    """The aligned reference [..., H, W, 3] with the distorted picture where it says nothing at all.

    Occluded pixels that alignment filled from clean neighbours are kept.
    """
    silent = (confidence <= 0) & (aligned.max(axis=-1) <= 0)
    return np.where(silent[..., None], distorted, aligned)


def reach(confidence: F32) -> F32:
    """How far a correction may go [H, W]: the confidence, spread by about two reference pixels and smoothed."""
    h, w = confidence.shape
    cells = _area(confidence, max(1, w // 4), max(1, h // 4))
    spread = cv2.blur(cv2.dilate(cells, np.ones((_REACH_CELLS, _REACH_CELLS), np.uint8)), (3, 3))
    return np.asarray(cv2.resize(spread, (w, h), interpolation=cv2.INTER_LINEAR), dtype=np.float32).reshape(h, w)


def padded(image: F32, *, zero: bool = False) -> F32:
    """``image`` [H, W, ...] with its last row and column repeated (or zeros) up to multiples of 8."""
    h, w = image.shape[:2]
    extra = ((0, -h % MULTIPLE_PX), (0, -w % MULTIPLE_PX)) + ((0, 0),) * (image.ndim - 2)
    if not any(after for _, after in extra):
        return image
    return np.pad(image, extra) if zero else np.pad(image, extra, mode="edge")


def _area(image: F32, width: int, height: int) -> F32:
    shrunk = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(shrunk, dtype=np.float32).reshape(height, width, *image.shape[2:])
