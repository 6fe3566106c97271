"""Closed-form restoration: take the low frequencies from the reference, keep the client's own detail.

Like is compared with like: the client's own splats are drawn *at the reference's pose and footprint* (``own``), so that
``reference - own`` holds what quantisation did and the codec's noise, and nothing of parallax or of a pixel's size.
That difference is what is brought to the client's view. In the reference's view

- a local affine fit of the reference's luma on ``own``'s (guided filter, He et al. 2010) gives the gain of the detail:
  where the client's detail does not follow the reference's it is damped, never amplified;
- the difference is split into its local mean, which averaging frees of noise, and the rest; each is taken by the
  Wiener weight of its own local power against the reference's noise, for luma and the two chromas (BT.709) apart.
  H.264 in 4:2:0 keeps luma to a few per cent of its local variance and loses half of the chroma's. Where the client's
  splats are as good as the reference can tell, the weights fall to zero and nothing changes.

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
from cags_client.restore.base import COMPARED, RestoreInput
from cags_common.geometry import F32
from cags_common.settings import check_settings, setting

YCC_OF_RGB = np.array([[0.2126, 0.7152, 0.0722], [-0.114572, -0.385428, 0.5], [0.5, -0.454153, -0.045847]], np.float32)
"""Luma and chroma of display-referred RGB (BT.709), the colours that the reference video is coded in."""

EVIDENCE_ROWS = 4
EVIDENCE_FLOOR = 1e-7
USUAL_FINE, USUAL_BROAD = (0.5, 0.65, 0.65), (1.7, 1.7, 1.7)
"""Share of the assumed noise power that H.264 at crf 20 has at most over a picture, luma and chromas, in the fine part
and in the local means (five scenes, walking and turning: 0.05-0.60, 0.2-1.4)."""

RGB_OF_YCC = np.linalg.inv(YCC_OF_RGB.astype(np.float64)).astype(np.float32)


@dataclass(frozen=True)
class AffineSettings:
    """Strengths of the closed-form restorer."""

    threads: int = setting(2, "threads of a restoration", low=1, high=64)
    radius_cells: int = setting(2, "radius of the local fit, in reference pixels", low=1, high=32)
    gain_prior: float = setting(2e-3, "variance that pulls the detail's gain to 1", low=0, high=1)
    noise: float = setting(1e-4, "variance of the reference's own error: H.264 at crf 20", low=0, high=1)
    luma_noise: float = setting(0.03, "share of the local luma variance that is such error too", low=0, high=10)
    chroma_noise: float = setting(0.6, "share of the local chroma variance: 4:2:0 loses its detail", low=0, high=10)
    leak_noise: float = setting(
        0.05, "share of the chroma variance that turns up in luma, where saturated colours are clipped", low=0, high=10
    )
    broad_noise: float = setting(0.1, "what a local mean keeps of the noise", low=0, high=1)

    def __post_init__(self) -> None:
        check_settings(self)


class AffineRestorer:
    """The closed-form tier."""

    name = "affine"
    needs = COMPARED

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
        change = inputs.distorted * sampled[..., :1] + sampled[..., 1:]
        change *= aligned.confidence[..., None]
        change += inputs.distorted
        return np.clip(change, 0.0, 1.0, out=change)

    def _by_kernels(self, inputs: RestoreInput, own: F32) -> F32:
        from cags_kernels import align as kernels

        s, aligned = self._settings, inputs.aligned
        parameters = kernels.CorrectParameters(
            radius_cells=s.radius_cells,
            gain_prior=s.gain_prior,
            noise=s.noise,
            luma_noise=s.luma_noise,
            chroma_noise=s.chroma_noise,
            leak_noise=s.leak_noise,
            broad_noise=s.broad_noise,
            threads=s.threads,
        )
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
    """[h, w, 4]: a factor and an offset a channel, such that ``factor * picture + offset`` is the change to it."""
    size = (2 * settings.radius_cells + 1,) * 2

    def mean(image: F32) -> F32:
        return np.asarray(cv2.boxFilter(image, -1, size, borderType=cv2.BORDER_REFLECT), dtype=np.float32)

    ours, theirs = own @ YCC_OF_RGB.T, reference @ YCC_OF_RGB.T
    mean_own, mean_reference = mean(ours), mean(theirs)
    variance = np.maximum(mean(ours * ours) - mean_own * mean_own, 0)
    covariance = mean(ours[..., 0] * theirs[..., 0]) - mean_own[..., 0] * mean_reference[..., 0]
    prior = np.float32(settings.gain_prior)
    gain = np.clip((covariance + prior) / (variance[..., 0] + prior), 0.0, 1.0)
    difference, broad = theirs - ours, mean_reference - mean_own
    power, broad_power = mean(difference * difference), broad * broad
    shares = np.array([settings.luma_noise, settings.chroma_noise, settings.chroma_noise], np.float32)
    noise = np.float32(settings.noise) + shares * variance
    noise[..., 0] += np.float32(settings.leak_noise) * (variance[..., 1] + variance[..., 2])
    broad_noise = noise * np.float32(settings.broad_noise)
    shown = (power[..., 0] + variance[..., 0]) > EVIDENCE_FLOOR
    trust_broad = _trust(broad_power, broad_noise, shown, USUAL_BROAD)
    trust_fine = _trust(power - broad_power, noise, shown, USUAL_FINE)
    correction = trust_broad * _wiener(broad_power, broad_noise) * broad
    correction += trust_fine * _wiener(power - broad_power, noise) * (difference - broad)
    factor = ((gain - 1) * _wiener(power[..., 0], noise[..., 0]) * trust_fine[0])[..., None]
    return np.concatenate([factor, correction @ RGB_OF_YCC.T - factor * own], axis=2).astype(np.float32, copy=False)


def _trust(power: F32, noise: F32, shown: NDArray[np.bool_], usual: tuple[float, ...]) -> F32:
    """[3] in [0, 1]: whether the whole picture holds evidence of more than the reference's own noise.

    ``usual`` is what H.264 alone makes of the ratio of the two. Every fourth row is looked at; ``shown`` [h, w] leaves
    void pixels out.
    """
    rows = slice(None, None, EVIDENCE_ROWS)
    p, n = power[rows][shown[rows]], noise[rows][shown[rows]]
    ratio = p.sum(axis=0, dtype=np.float64) / np.maximum(n.sum(axis=0, dtype=np.float64), 1e-12)
    return np.asarray(np.clip(2 * (ratio / np.array(usual) - 1), 0.0, 1.0), dtype=np.float32)


def _wiener(power: F32, noise: F32) -> F32:
    """Weight of a signal whose measured power holds the noise too."""
    return np.asarray(np.clip(1 - noise / np.maximum(power, np.float32(1e-12)), 0.0, 1.0), dtype=np.float32)
