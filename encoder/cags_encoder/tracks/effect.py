"""The visible difference between two versions of the same splats."""

from __future__ import annotations

import numpy as np

from cags_common.geometry import F32, F64
from cags_common.splats import SH_C0, Splats


def visible_effect(a: Splats, b: Splats) -> F64:
    """Upper estimate [n] of a pixel's change in colour (0..1) if splats ``a`` are drawn instead of ``b``.

    Each of these counts as one, weighted by opacity: a shift by a splat's mean radius, a scaling by e, a rotation of a
    long splat by a radian, and a full change of colour. It is an order of magnitude, meant for thresholds.
    """
    opacity_a, opacity_b = drawn(a.logit_opacities), drawn(b.logit_opacities)
    shift, scaling, turn, colour, harmonics = _looks(a, b)
    parts = shift + scaling + turn + (colour + harmonics)
    effect: F64 = np.abs(opacity_a - opacity_b) + np.maximum(opacity_a, opacity_b) * parts
    return effect


def attribute_effects(a: Splats, b: Splats) -> dict[str, F64]:
    """Contribution [n] of each attribute to :func:`visible_effect`."""
    opacity_a, opacity_b = drawn(a.logit_opacities), drawn(b.logit_opacities)
    names = ("position", "scale", "rotation", "colour", "harmonics")
    parts = {name: np.maximum(opacity_a, opacity_b) * part for name, part in zip(names, _looks(a, b), strict=True)}
    return {"opacity": np.abs(opacity_a - opacity_b), **parts}


def _looks(a: Splats, b: Splats) -> tuple[F64, F64, F64, F64, F64]:
    """Differences [n] of position, scale, rotation, colour and harmonics, for opaque splats."""
    radius = np.exp(np.clip(b.log_scales.astype(np.float64), -30, 30))
    shift = np.linalg.norm(a.means.astype(np.float64) - b.means, axis=1) / np.maximum(radius.mean(axis=1), 1e-12)
    scaling = np.abs(a.log_scales - b.log_scales).max(axis=1)
    stretch = np.minimum(np.ptp(b.log_scales, axis=1), 1.0)
    turn = 2 * np.arccos(np.clip(np.abs(np.einsum("ij,ij->i", a.quats, b.quats, dtype=np.float64)), 0, 1)) * stretch
    colour = SH_C0 * np.abs(a.sh0 - b.sh0).max(axis=1)
    harmonics = 0.5 * np.abs(a.sh_rest - b.sh_rest).max(axis=2).sum(axis=1)
    return shift, scaling, turn, colour, harmonics


def of_axes(log_scales: F32) -> F64:
    """Weights [n, 3] of changes of each of ``log_scales`` [n, 3], natural logarithms of standard deviations: 1 of a
    splat's two longer axes; of the shortest the root of its length, in lengths of the middle one.

    The shortest axis of a flat splat shows from its edge alone. Of a disc with an axis ``r`` times as long as the
    others, seen from all directions alike, the drawn area changes by ``sqrt(pi r / 4)`` of a small change of it, in the
    root mean square.
    """
    middle = np.sort(log_scales, axis=1)[:, 1:2].astype(np.float64)
    weights: F64 = np.exp(np.clip((log_scales - middle) / 2, -30, 0))
    return weights


def drawn(logits: F32) -> F64:
    """Opacities [n], 0 to 1, from their logits."""
    opacities: F64 = 1.0 / (1.0 + np.exp(-np.clip(logits.astype(np.float64), -30, 30)))
    return opacities
