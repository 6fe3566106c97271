"""How splats are cut into separately quantised attributes, and put together again.

An attribute is a small vector a splat, in the parameters of :class:`~cags_common.splats.Splats` (log scales, opacity
logits, SH coefficients). Means are not among them: positions are coded geometrically, with each tile.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from cags_common.errors import DecodeError
from cags_common.geometry import F32
from cags_common.splats import SH_REST_OF_DEGREE, Splats

ATTRIBUTE_DIMS: dict[str, int] = {
    "scale": 3,  # log_scales
    "rotation_real": 1,  # quats w
    "rotation_imag": 3,  # quats xyz
    "rotation": 3,  # modified Rodrigues parameters xyz / (1 + w), instead of the two above
    "opacity": 1,  # logit_opacities
    "alpha": 1,  # drawn opacity 0..1, instead of the one above
    "sh0": 3,  # RGB
    "sh1": 9,  # 3 coefficients x RGB
    "sh2": 15,
    "sh3": 21,
}
"""Every attribute and its dimension, in the order in which they are coded.

Modified Rodrigues parameters tell all rotations with w >= 0 apart by three numbers of at most 1, and small changes of
them are small rotations everywhere, also at 180 degrees, where leaving out w loses all precision.
"""

SH_REST_ATTRIBUTES = ("sh1", "sh2", "sh3")
ROTATION_PARTS = ("rotation_real", "rotation_imag")

_FORMS = {"rotation": (("rotation",), ROTATION_PARTS), "opacity": (("alpha",), ("opacity",))}

_MIN_ALPHA = 1e-4
"""Decoded opacities stay this far inside 0..1, so that their logits are finite; 1/255 is the least that is drawn."""


def split_attributes(splats: Splats) -> dict[str, F32]:
    """Attribute name -> values [n, dim], in every form that an attribute has."""
    n = len(splats)
    logits = splats.logit_opacities.reshape(n, 1)
    out = {
        "scale": splats.log_scales,
        "rotation_real": splats.quats[:, :1],
        "rotation_imag": splats.quats[:, 1:],
        "rotation": splats.quats[:, 1:] / (1 + splats.quats[:, :1]),
        "opacity": logits,
        "alpha": (1 / (1 + np.exp(-np.clip(logits, -30, 30)))).astype(np.float32),
        "sh0": splats.sh0,
    }
    for degree in range(1, splats.sh_degree + 1):
        band = splats.sh_rest[:, SH_REST_OF_DEGREE[degree - 1] : SH_REST_OF_DEGREE[degree]]
        out[f"sh{degree}"] = band.reshape(n, band.shape[1] * 3)
    return out


def join_attributes(means: F32, values: Mapping[str, F32]) -> Splats:
    """Inverse of :func:`split_attributes`, from one form of each attribute; rotations come out unit with w >= 0.

    Raises :class:`DecodeError` when an attribute is missing.
    """
    n = len(means)
    degree = sum(name in values for name in SH_REST_ATTRIBUTES)
    wanted = ["scale", "sh0", *SH_REST_ATTRIBUTES[:degree]]
    wanted += [next((f for f in forms if values.keys() >= set(f)), (name,))[0] for name, forms in _FORMS.items()]
    for name in wanted:
        if name not in values:
            raise DecodeError(f"attribute {name!r} is missing; there are: {', '.join(values)}")
    bands = [values[name].reshape(n, ATTRIBUTE_DIMS[name] // 3, 3) for name in SH_REST_ATTRIBUTES[:degree]]
    return Splats(
        means=means,
        quats=_quaternions(values),
        log_scales=values["scale"],
        logit_opacities=_logits(values),
        sh0=values["sh0"],
        sh_rest=np.concatenate(bands, axis=1) if bands else np.zeros((n, 0, 3), np.float32),
    )


def _logits(values: Mapping[str, F32]) -> F32:
    if "opacity" in values:
        return np.ascontiguousarray(values["opacity"][:, 0])
    return np.ascontiguousarray(alpha_logits(values["alpha"])[:, 0])


def alpha_logits(alpha: F32) -> F32:
    """Opacity logits of drawn opacities, kept inside (0, 1).

    Logarithms are taken of doubles and then rounded: single-precision ones differ between processors and libraries, and
    servers, players and browsers have to show the same.
    """
    inside = np.clip(alpha, np.float32(_MIN_ALPHA), np.float32(1 - _MIN_ALPHA))
    logits: F32 = np.log((inside / (1 - inside)).astype(np.float64)).astype(np.float32)
    return logits


def _quaternions(values: Mapping[str, F32]) -> F32:
    if "rotation" not in values:
        return unit_quaternions(np.concatenate([values["rotation_real"], values["rotation_imag"]], axis=1))
    rodrigues = values["rotation"]
    square = _squares(rodrigues)
    # Refinement may carry parameters a little beyond length 1, which is a turn of more than 180 degrees.
    shrink = np.where(square > 1, np.float32(-1), np.float32(1)) / (1 + square)
    quats = np.empty((len(square), 4), np.float32)
    np.multiply(1 - square, shrink, out=quats[:, 0])
    np.multiply(rodrigues, (2 * shrink)[:, None], out=quats[:, 1:])
    return quats


def unit_quaternions(quats: F32) -> F32:
    """Quaternions [n, 4] made unit with w >= 0; those without a direction become the identity."""
    norms = np.sqrt(_squares(quats))
    lost = norms < 1e-12
    sign = np.where(quats[:, 0] < 0, np.float32(-1.0), np.float32(1.0))
    out = quats * (sign / np.where(lost, np.float32(1.0), norms))[:, None]
    out[lost] = (1.0, 0.0, 0.0, 0.0)
    return np.ascontiguousarray(out, dtype=np.float32)


def _squares(rows: F32) -> F32:
    """Sum of squares [n] of each row, from the first column to the last: the order that the kernel adds in."""
    total = rows[:, 0] * rows[:, 0]
    for column in rows.T[1:]:
        total += column * column
    return total
