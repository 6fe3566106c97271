"""Closed-form restoration: take the low frequencies from the reference, keep the client's own detail.

Like is compared with like: the client's own splats are drawn *at the reference's pose and footprint* (``own``), so that
``reference - own`` holds what quantisation did and the codec's noise, and nothing of parallax or of a pixel's size.
That difference is what is brought to the client's view. In the reference's view

- a local affine fit of the reference on ``own`` (guided filter, He et al. 2010) gives the gain of the detail: where the
  client's detail does not follow the reference's it is damped, never amplified;
- the difference is split into its local mean, which averaging frees of noise, and the rest; each is taken by the
  Wiener weight of its own local power against the reference's noise. Where the client's splats are as good as the
  reference can tell, both weights fall to zero and nothing changes.

Both fields are sampled through the alignment:

    restored = distorted + confidence * ((gain - 1) * (distorted - own) + correction)
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

import cags_kernels
from cags_client.align.fast import sample
from cags_client.restore.base import RestoreInput
from cags_common.geometry import F32
from cags_common.settings import check_settings, setting


@dataclass(frozen=True)
class AffineSettings:
    """Strengths of the closed-form restorer."""

    threads: int = setting(2, "threads of a restoration", low=1, high=64)
    radius_cells: int = setting(2, "radius of the local fit, in reference pixels", low=1, high=32)
    gain_prior: float = setting(2e-3, "variance that pulls the detail's gain to 1", low=0, high=1)
    noise: float = setting(2e-4, "variance of the reference's own error: H.264 at crf 20", low=0, high=1)
    detail_noise: float = setting(0.03, "share of the local variance that counts as such error too", low=0, high=10)

    def __post_init__(self) -> None:
        check_settings(self)


class AffineRestorer:
    """The closed-form tier."""

    name = "affine"

    def __init__(self, settings: AffineSettings | None = None) -> None:
        self._settings = settings or AffineSettings()

    def restore(self, inputs: RestoreInput) -> F32:
        """See :class:`cags_client.restore.base.Restorer`."""
        own = inputs.own.rgb if inputs.own is not None else _averaged(inputs)
        if cags_kernels.native_available():
            return self._by_kernels(inputs, own)
        aligned = inputs.aligned
        fields = correction_fields(np.clip(own, 0.0, 1.0), inputs.reference.rgb, self._settings)
        sampled = sample(fields, aligned.x, aligned.y)
        change = inputs.distorted * sampled[..., :3] + sampled[..., 3:]
        change *= aligned.confidence[..., None]
        change += inputs.distorted
        return np.clip(change, 0.0, 1.0, out=change)

    def _by_kernels(self, inputs: RestoreInput, own: F32) -> F32:
        from cags_kernels import align as kernels

        s, aligned = self._settings, inputs.aligned
        parameters = kernels.CorrectParameters(s.radius_cells, s.gain_prior, s.noise, s.detail_noise, s.threads)
        view = kernels.Reprojection(aligned.geometry.depth, *aligned.geometry.matrix)
        return kernels.correct(
            own,
            inputs.reference.rgb,
            view,
            parameters,
            distorted=inputs.distorted,
            confidence=aligned.confidence,
        )


def _averaged(inputs: RestoreInput) -> F32:
    aligned = inputs.aligned
    return average_down(inputs.distorted, aligned.x, aligned.y, aligned.confidence, inputs.reference.rgb)


def average_down(picture: F32, x: F32, y: F32, confidence: F32, fallback: F32) -> F32:
    """Mean [h, w, 3] of ``picture`` over the pixels that land in each reference pixel; ``fallback`` where none does.

    A stand-in for the client's splats drawn at the reference's pose, for callers without a rasteriser. It is worse at
    silhouettes: pixels that the client does not see are missing from its means.
    """
    h, w = fallback.shape[:2]
    shown = confidence > 0
    rows = np.minimum(y[shown].astype(np.intp), h - 1)
    cell: NDArray[np.intp] = rows * w + np.minimum(x[shown].astype(np.intp), w - 1)
    count = np.bincount(cell, minlength=h * w)
    known = count > 0
    low = fallback.reshape(-1, 3).copy()
    for channel in range(3):
        total = np.bincount(cell, weights=picture[..., channel][shown], minlength=h * w)
        low[known, channel] = total[known] / count[known]
    return low.reshape(h, w, 3)


def correction_fields(own: F32, reference: F32, settings: AffineSettings) -> F32:
    """[h, w, 6]: factor and offset a channel, such that ``factor * picture + offset`` is the change to the picture."""
    size = (2 * settings.radius_cells + 1,) * 2

    def mean(image: F32) -> F32:
        return np.asarray(cv2.boxFilter(image, -1, size, borderType=cv2.BORDER_REFLECT), dtype=np.float32)

    mean_own, mean_reference = mean(own), mean(reference)
    variance = np.maximum(mean(own * own) - mean_own * mean_own, 0)
    covariance = mean(own * reference) - mean_own * mean_reference
    prior = np.float32(settings.gain_prior)
    gain = np.clip((covariance + prior) / (variance + prior), 0.0, 1.0)
    difference = reference - own
    broad = mean_reference - mean_own
    power, broad_power = _channel_mean(mean(difference * difference)), _channel_mean(broad * broad)
    noise = np.float32(settings.noise) + np.float32(settings.detail_noise) * _channel_mean(variance)
    weight = _wiener(power, noise)
    correction = _wiener(broad_power, noise / np.float32(size[0])) * broad
    correction += _wiener(power - broad_power, noise) * (difference - broad)
    factor = (gain - 1) * weight
    return np.concatenate([factor, correction - factor * own], axis=2)


def _channel_mean(image: F32) -> F32:
    return np.asarray(image.mean(axis=2, keepdims=True), dtype=np.float32)


def _wiener(power: F32, noise: F32) -> F32:
    """Weight of a signal whose measured power holds the noise too."""
    return np.asarray(np.clip(1 - noise / np.maximum(power, np.float32(1e-12)), 0.0, 1.0), dtype=np.float32)
