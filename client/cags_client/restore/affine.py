"""Closed-form restoration: take the low frequencies from the reference, keep the client's own detail.

The distorted picture is averaged down to the reference's pixels *through the alignment*, over the pixels that the
reference truly shows, so that like is compared with like. There a local affine fit (He et al. 2010, guided image
filtering) gives the gain of the detail, and the error that is left is split in two: its local mean, which averaging has
freed of noise, is taken whole; the rest is taken by a Wiener weight, because at the reference's finest scale part of
the difference is the codec's and the footprint's. Both fields are brought back up through the alignment:

    restored = distorted + confidence * (gain' * (distorted - low) + correction)

with ``gain' = gain - 1``. Where the reference says nothing the confidence is 0 and the distorted picture stays.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from cags_client.align.fast import sample
from cags_client.restore.base import RestoreInput
from cags_common.geometry import F32
from cags_common.settings import check_settings, setting


@dataclass(frozen=True)
class AffineSettings:
    """Strengths of the closed-form restorer."""

    radius_cells: int = setting(2, "radius of the local fit, in reference pixels", low=1, high=32)
    gain_prior: float = setting(2e-3, "variance that pulls the detail's gain to 1", low=0, high=1)
    gain_limit: float = setting(1.6, "largest gain of the detail; 1 keeps the detail as it is", low=1, high=8)
    noise: float = setting(4e-4, "variance of the reference's own error", low=0, high=1)
    detail_noise: float = setting(0.15, "share of the local variance that counts as such error too", low=0, high=10)

    def __post_init__(self) -> None:
        check_settings(self)


class AffineRestorer:
    """The closed-form tier."""

    name = "affine"

    def __init__(self, settings: AffineSettings | None = None) -> None:
        self._settings = settings or AffineSettings()

    def restore(self, inputs: RestoreInput) -> F32:
        """See :class:`cags_client.restore.base.Restorer`."""
        aligned, reference = inputs.aligned, inputs.reference
        low, weight = average_down(inputs.distorted, aligned.x, aligned.y, aligned.confidence, reference.rgb)
        gain, correction = _fit(low, reference.rgb, weight, self._settings)
        # detail * gain' + correction = distorted * gain' + (correction - gain' * low): two fields to sample, not three
        fields = sample(np.concatenate([gain, correction - gain * low], axis=2), aligned.x, aligned.y)
        change = inputs.distorted * fields[..., :3] + fields[..., 3:]
        change *= aligned.confidence[..., None]
        return np.clip(inputs.distorted + change, 0.0, 1.0)


def average_down(picture: F32, x: F32, y: F32, confidence: F32, fallback: F32) -> tuple[F32, F32]:
    """Mean of ``picture`` over the pixels that land in each reference pixel, and how well it is known.

    Returns the mean [h, w, 3] (``fallback`` where nothing lands, so that nothing is corrected there) and a weight
    [h, w] in [0, 1]: the share of the usual number of pixels that landed.
    """
    h, w = fallback.shape[:2]
    shown = confidence > 0
    cell: NDArray[np.intp] = np.minimum(y[shown].astype(np.intp), h - 1) * w + np.minimum(
        x[shown].astype(np.intp), w - 1
    )
    count = np.bincount(cell, minlength=h * w).astype(np.float32)
    known = count > 0
    usual = float(np.median(count[known])) if known.any() else 1.0
    low = fallback.reshape(-1, 3).copy()
    for channel in range(3):
        total = np.bincount(cell, weights=picture[..., channel][shown], minlength=h * w)
        low[known, channel] = total[known] / count[known]
    return low.reshape(h, w, 3), np.minimum(count / max(usual, 1.0), 1.0).reshape(h, w).astype(np.float32)


def _fit(low: F32, reference: F32, weight: F32, settings: AffineSettings) -> tuple[F32, F32]:
    """Excess gain [h, w, 3] of the detail, and the correction [h, w, 3] of the low frequencies."""
    size = (2 * settings.radius_cells + 1,) * 2

    def mean(image: F32) -> F32:
        return np.asarray(cv2.boxFilter(image, -1, size, borderType=cv2.BORDER_REFLECT), dtype=np.float32)

    w = weight[..., None]
    total = np.maximum(mean(weight), np.float32(1e-4))[..., None]
    mean_low, mean_ref = mean(low * w) / total, mean(reference * w) / total
    var = np.maximum(mean(low * low * w) / total - mean_low**2, 0)
    cov = mean(low * reference * w) / total - mean_low * mean_ref
    prior = np.float32(settings.gain_prior)
    gain = np.clip((cov + prior) / (var + prior), 1 / settings.gain_limit, settings.gain_limit)
    error = (reference - low) * w
    broad = mean(error.astype(np.float32)) / total
    fine = error - broad * w
    power = mean((fine * fine).astype(np.float32)) / total
    noise = np.float32(settings.noise) + np.float32(settings.detail_noise) * var
    wiener = np.clip(power / (power + noise), 0, 1)
    correction = broad * np.minimum(total * 4, 1) + fine * wiener
    return (gain - 1).astype(np.float32), correction.astype(np.float32)
