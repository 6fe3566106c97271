"""How visible the difference between two versions of the same splats is."""

from __future__ import annotations

import numpy as np

from cags_common.geometry import F32, F64
from cags_common.splats import SH_C0, Splats


def visible_effect(a: Splats, b: Splats) -> F64:
    """Upper estimate [n] of the change of a pixel's colour (0..1) when splats ``a`` are drawn instead of ``b``.

    A shift by a splat's own radius, a scaling by e, a turn by a radian of a long splat, or a full change of colour
    count as one, weighed by opacity. An order of magnitude, meant for thresholds.
    """
    opacity_a, opacity_b = drawn(a.logit_opacities), drawn(b.logit_opacities)
    shift, scaling, turn, colour, harmonics = _looks(a, b)
    parts = shift + scaling + turn + (colour + harmonics)
    effect: F64 = np.abs(opacity_a - opacity_b) + np.maximum(opacity_a, opacity_b) * parts
    return effect


def attribute_effects(a: Splats, b: Splats) -> dict[str, F64]:
    """What each attribute by itself adds to :func:`visible_effect` [n]."""
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


def drawn(logits: F32) -> F64:
    """Drawn opacities [n], 0 to 1, of their logits."""
    opacities: F64 = 1.0 / (1.0 + np.exp(-np.clip(logits.astype(np.float64), -30, 30)))
    return opacities
