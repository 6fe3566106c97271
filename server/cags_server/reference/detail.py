"""What a reference leaves of the detail that is finer than its own pixels.

A client shows more pixels than a reference has. Between these, a difference leaves the client's own detail as it is; a
picture makes it give way where it is not the scene's (:mod:`cags_common.correction.trust`). No reference shows how well
the two do there, but its finest octave does: images have about as much detail in the next.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from cags_common.geometry import F32, Intrinsics

BLOCK_PX = 8

LEAST_POWER = 1e-9


@dataclass(frozen=True)
class DetailLeft:
    """Mean squared error, [0, 1] RGB, of what is finer than a reference's pixels."""

    difference: float
    """Of the client's own detail."""
    picture: float
    """Of as much of it as is the scene's."""


def detail_left(truth: F32, lack: F32, octaves: float) -> DetailLeft:
    """Of a view ``truth`` [h, w, 3], in which a client lacks ``lack`` [h, w, 3], shown ``octaves`` finer."""
    if octaves <= 0:
        return DetailLeft(0.0, 0.0)
    scene, wrong = _finest(truth), _finest(lack)
    own = scene - wrong
    together, power = by_block(scene, own), by_block(own, own)
    kept = np.clip(together / np.maximum(power, LEAST_POWER), 0, 1)
    left = by_block(scene, scene) - kept * (2 * together - kept * power)
    return DetailLeft(octaves * float(by_block(wrong, wrong).mean()), octaves * float(left.mean()))


def octaves_finer(display: Intrinsics, reference: Intrinsics) -> float:
    """By how many octaves a display shows more than a reference has."""
    return max(0.0, math.log2(display.fx_px / reference.fx_px))


def _finest(image: F32) -> F32:
    return np.asarray(image - cv2.blur(image, (3, 3)))


def by_block(a: F32, b: F32, side: int = BLOCK_PX) -> F32:
    """Means of ``a b`` [h, w, 3] over blocks of ``side`` x ``side`` pixels and the channels."""
    product = cv2.transform(cv2.multiply(a, b), _MEAN)
    size = -(-a.shape[1] // side), -(-a.shape[0] // side)
    return np.asarray(cv2.resize(product, size, interpolation=cv2.INTER_AREA))


_MEAN = np.full((1, 3), 1 / 3, np.float32)
