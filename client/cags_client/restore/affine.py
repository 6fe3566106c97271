"""Closed-form restoration: take the low frequencies from the reference, keep the client's own detail.

Like is compared with like: the client's own splats are drawn *at the reference's pose and footprint* (``own``), so that
``reference - own`` holds what quantisation did and the codec's noise, and nothing of parallax or of a pixel's size.
That difference is what is brought to the client's view. In the reference's view

- a local affine fit of the reference's luma on ``own``'s (guided filter, He et al. 2010) gives the gain of the detail:
  where the client's detail does not follow the reference's it is damped, never amplified;
- the difference is split into its local mean, which averaging frees of noise, and the rest; each is taken by the
  Wiener weight of its own local power against the reference's noise, for luma and the two chromas (BT.709) apart.
  How large that noise is the server measures and says (:class:`~cags_common.video.noise.CodingNoise`). Where the
  client's splats are as good as the reference can tell, the weights fall to zero and nothing changes.

Both fields are sampled through the alignment:

    restored = distorted + weight * confidence * ((gain - 1) * (distorted - own) + correction)

The weight says how well the alignment fits. Sampled through it, the client's own view should look like the client's
picture, block by block; where it does not (a wrong depth, half-transparent layers, something hidden, a grazing view),
the difference lands in the wrong place just as well. Blocks that disagree by much more than the correction is worth
(:func:`registration`) keep the distorted picture. Splats of few bits need large corrections, which stay. Where
one splat makes up much of the picture, it may veil one view alone (large splats close to a camera, haze). Then the
correction counts as far as it is worth more than the average difference of the two views, and where it would correct
what is at full LoD almost everywhere, it is taken for the veil's (:mod:`cags_client.restore.veil`). Under a step that
is large against what is looked at it fades altogether (:mod:`cags_client.restore.parallax`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

import cags_kernels
from cags_client.align.base import ReferencePicture
from cags_client.align.fast import sample
from cags_client.restore.base import COMPARED, RestoreInput
from cags_client.restore.pair import OncePerPair
from cags_client.restore.parallax import PLACED_FROM, kept, placed, relative_step
from cags_client.restore.veil import plausible
from cags_common.geometry import F32
from cags_common.settings import check_settings, setting
from cags_common.video.noise import VOID_POWER, YCC_OF_RGB

if TYPE_CHECKING:
    from cags_kernels.align import CorrectParameters

EVIDENCE_ROWS = 4
EVIDENCE_MARGIN = 1.05
"""A picture whose errors have no more than this times the power of coding noise holds no evidence of its own."""

NOISE_FLOOR = 2e-6
"""Variance of rounding to 8 bits, in the reference and in what it is compared with."""

VEIL_WEIGHT = 2.2
"""Weight of what veils one view alone against what the correction is worth. It acts by its fourth power: where the veil
is the smaller, which it is nearly always in sound corrections, next to nothing is given up."""

WINDOW_BLOCKS = 7
"""Side of the window over which an alignment is judged. A misplaced picture shifts whole areas; what differs at single
blocks is mostly how either view samples its detail (3 blocks cost 0.6 dB in the middle of the ladder)."""

LEAST_POWER = 1e-12
"""Of a correction, where there is none."""

RGB_OF_YCC = np.linalg.inv(YCC_OF_RGB.astype(np.float64)).astype(np.float32)


@dataclass(frozen=True)
class AffineSettings:
    """Strengths of the closed-form restorer."""

    threads: int = setting(2, "threads of a restoration", low=1, high=64)
    radius_cells: int = setting(2, "radius of the local fit, in reference pixels", low=1, high=32)
    gain_prior: float = setting(2e-3, "variance that pulls the detail's gain to 1", low=0, high=1)
    misregistration: float = setting(
        0.1,
        "weight of what the alignment gets wrong against what the correction is worth; 0 does not look",
        low=0,
        high=10,
    )

    def __post_init__(self) -> None:
        check_settings(self)


class AffineRestorer:
    """The closed-form tier."""

    name = "affine"
    needs = COMPARED

    def __init__(self, settings: AffineSettings | None = None) -> None:
        self._settings = settings or AffineSettings()
        self._fields = OncePerPair(partial(fields_of, settings=self._settings))

    def restore(self, inputs: RestoreInput) -> F32:
        """See :class:`cags_client.restore.base.Restorer`."""
        own = own_view(inputs)
        # the kernel makes and applies fields in one go, which is the quicker way for those that no later frame uses
        needed = self._fields.repeats(inputs) or inputs.expected is not None
        return corrected(inputs, own, self._settings, self._fields.of(inputs, own) if needed else None)


def own_view(inputs: RestoreInput) -> F32:
    """The client's splats seen from the reference [h, w, 3] in [0, 1], or a stand-in where nobody drew them."""
    if inputs.own is not None:
        return np.clip(inputs.own.rgb, 0.0, 1.0)
    aligned = inputs.aligned
    return average_down(inputs.distorted, aligned.x, aligned.y, aligned.confidence, inputs.reference.rgb)


def fields_of(own: F32, reference: ReferencePicture, settings: AffineSettings) -> F32:
    """[h, w, 4]: a factor and an offset a channel, such that ``factor * picture + offset`` is the change to it."""
    if not cags_kernels.native_available():
        return correction_fields(own, reference, settings)
    from cags_kernels import align as kernels

    return kernels.fields(own, reference.rgb, _parameters(settings, reference))


def corrected(inputs: RestoreInput, own: F32, settings: AffineSettings, fields: F32 | None = None) -> F32:
    """The distorted picture [H, W, 3] changed by ``fields`` [h, w, 4]; without them, by :func:`fields_of`.

    Fields that are given count as far as they are plausible (``inputs.expected``).
    """
    aligned = inputs.aligned
    step = relative_step(aligned.geometry)
    if step > PLACED_FROM:
        fields = placed(fields_of(own, inputs.reference, settings) if fields is None else fields, own, step)
    share = kept(aligned.geometry)
    confidence = aligned.confidence if share is None else aligned.confidence * share
    if fields is not None and inputs.expected is not None:
        fields = plausible(fields, own, inputs.reference.rgb, inputs.expected)
    if cags_kernels.native_available():
        from cags_kernels import align as kernels

        parameters = _parameters(settings, inputs.reference)
        parameters = replace(parameters, block_px=aligned.geometry.block_px, veil=inputs.veil)
        view = kernels.Reprojection(aligned.geometry.depth, *aligned.geometry.matrix)
        pictures = {"distorted": inputs.distorted, "confidence": confidence}
        return kernels.correct(own, inputs.reference.rgb, view, parameters, **pictures, fields=fields)
    if fields is None:
        fields = correction_fields(own, inputs.reference, settings)
    sampled = sample(fields, aligned.x, aligned.y)
    change = inputs.distorted * sampled[..., :1] + sampled[..., 1:]
    trusting = replace(inputs, aligned=replace(aligned, confidence=confidence))
    change *= (confidence * registration(trusting, own, fields, settings.misregistration))[..., None]
    change += inputs.distorted
    return np.clip(change, 0.0, 1.0, out=change)


def corrected_there(own: F32, reference: ReferencePicture, settings: AffineSettings) -> F32:
    """``own`` [h, w, 3] in [0, 1], the client's splats seen from the reference, corrected without leaving that view."""
    if not cags_kernels.native_available():
        fields = correction_fields(own, reference, settings)
        return np.clip(own + (own * fields[..., :1] + fields[..., 1:]), 0.0, 1.0)
    from cags_kernels import align as kernels

    ones = np.ones(own.shape[:2], np.float32)
    parameters = _parameters(replace(settings, misregistration=0.0), reference)
    view = kernels.Reprojection(ones, np.eye(3), np.zeros(3))
    return kernels.correct(own, reference.rgb, view, parameters, distorted=own, confidence=ones)


def _parameters(settings: AffineSettings, reference: ReferencePicture) -> CorrectParameters:
    from cags_kernels import align as kernels

    return kernels.CorrectParameters(
        radius_cells=settings.radius_cells,
        gain_prior=settings.gain_prior,
        fine_noise=reference.noise.fine,
        broad_noise=reference.noise.broad,
        block_px=1,
        misregistration=settings.misregistration,
        threads=settings.threads,
    )


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


def correction_fields(own: F32, reference: ReferencePicture, settings: AffineSettings) -> F32:
    """[h, w, 4]: a factor and an offset a channel, such that ``factor * picture + offset`` is the change to it."""
    size = (2 * settings.radius_cells + 1,) * 2

    def mean(image: F32) -> F32:
        return np.asarray(cv2.boxFilter(image, -1, size, borderType=cv2.BORDER_REFLECT), dtype=np.float32)

    ours, theirs = own @ YCC_OF_RGB.T, reference.rgb @ YCC_OF_RGB.T
    mean_own, mean_reference = mean(ours), mean(theirs)
    variance = np.maximum(mean(ours * ours) - mean_own * mean_own, 0)
    product = mean(ours[..., 0] * theirs[..., 0])
    covariance = product - mean_own[..., 0] * mean_reference[..., 0]
    prior = np.float32(settings.gain_prior)
    gain = np.clip((covariance + prior) / (variance[..., 0] + prior), 0.0, 1.0)
    difference, broad = theirs - ours, mean_reference - mean_own
    power, broad_power = mean(difference * difference), broad * broad
    noise = np.float32(NOISE_FLOOR) + np.asarray(reference.noise.fine, np.float32) * np.sqrt(variance)
    broad_noise = np.broadcast_to(np.float32(NOISE_FLOOR) + np.asarray(reference.noise.broad, np.float32), noise.shape)
    shown = (power[..., 0] + 2 * product) > VOID_POWER  # the sum of both pictures' powers
    trust_broad = _trust(broad_power, broad_noise, shown)
    trust_fine = _trust(power - broad_power, noise, shown)
    correction = trust_broad * _wiener(broad_power, broad_noise) * broad
    correction += trust_fine * _wiener(power - broad_power, noise) * (difference - broad)
    factor = ((gain - 1) * _wiener(power[..., 0], noise[..., 0]) * trust_fine[0])[..., None]
    return np.concatenate([factor, correction @ RGB_OF_YCC.T - factor * own], axis=2).astype(np.float32, copy=False)


def registration(inputs: RestoreInput, own: F32, fields: F32, misregistration: float) -> F32:
    """Weight [H, W] of the correction by ``fields`` [h, w, 4], from ``own`` [h, w, 3] against the distorted picture.

    S P / (P + misregistration * e): P is the mean power of the correction, e that of the local disagreement, which is
    averaged over WINDOW_BLOCKS x WINDOW_BLOCKS before it is squared, so that detail that the reference cannot hold does
    not count.
    S is 1 / (1 + (VEIL_WEIGHT v / P)^4), with v the power of the mean disagreement of the whole picture, as far as a
    veil is suspected (``inputs.veil``), and else 1.
    """
    aligned, block = inputs.aligned, inputs.aligned.geometry.block_px
    height, width = aligned.confidence.shape
    rows, columns = height // block, width // block
    if not (rows and columns and misregistration):
        return np.ones((height, width), np.float32)
    central = slice(block // 2, None, block)
    x, y, c = (a[central, central][:rows, :columns] for a in (aligned.x, aligned.y, aligned.confidence))
    shape = (rows, block, columns, block, 3)
    mean = inputs.distorted[: rows * block, : columns * block].reshape(shape).mean(axis=(1, 3))
    there, field = sample(own, x, y), sample(fields, x, y)
    power = np.square(c[..., None] * (mean * field[..., :1] + field[..., 1:])).sum(axis=2)
    seen = (c > 0) & (np.square(mean).sum(axis=2) + np.square(there).sum(axis=2) > VOID_POWER)
    worth = np.float32(max(power[seen].mean(dtype=np.float64) if seen.any() else 0.0, LEAST_POWER))
    away = np.asarray(c[..., None] * (mean - there), np.float32)
    wrong = (
        np.square(cv2.blur(away, (WINDOW_BLOCKS,) * 2, borderType=cv2.BORDER_REPLICATE))
        .reshape(*c.shape, 3)
        .sum(axis=2)
    )
    veil = np.square(away[seen].mean(axis=0, dtype=np.float64)).sum() if seen.any() else 0.0
    share = np.float32(1 - inputs.veil * (1 - 1 / (1 + (VEIL_WEIGHT * veil / float(worth)) ** 4)))
    weight = share * worth / (worth + np.float32(misregistration) * wrong)
    across = (np.arange(width, dtype=np.float32) + np.float32(0.5)) / np.float32(block)
    down = (np.arange(height, dtype=np.float32) + np.float32(0.5)) / np.float32(block)
    return sample(weight[..., None], *np.meshgrid(across, down))[..., 0]


def _trust(power: F32, noise: F32, shown: NDArray[np.bool_]) -> F32:
    """[3] in [0, 1]: whether the whole picture holds evidence of more than the reference's own noise.

    Every fourth row is looked at; ``shown`` [h, w] leaves void pixels out.
    """
    rows = slice(None, None, EVIDENCE_ROWS)
    p, n = power[rows][shown[rows]], noise[rows][shown[rows]]
    ratio = p.sum(axis=0, dtype=np.float64) / np.maximum(n.sum(axis=0, dtype=np.float64), 1e-12)
    return np.asarray(np.clip(2 * (ratio / EVIDENCE_MARGIN - 1), 0.0, 1.0), dtype=np.float32)


def _wiener(power: F32, noise: F32) -> F32:
    """Weight of a signal whose measured power holds the noise too."""
    return np.asarray(np.clip(1 - noise / np.maximum(power, np.float32(1e-12)), 0.0, 1.0), dtype=np.float32)
