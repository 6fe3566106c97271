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
    "opacity": 1,  # logit_opacities
    "sh0": 3,  # RGB
    "sh1": 9,  # 3 coefficients x RGB
    "sh2": 15,
    "sh3": 21,
}
"""Every attribute and its dimension, in the order in which they are coded."""

SH_REST_ATTRIBUTES = ("sh1", "sh2", "sh3")


def attributes_of_degree(sh_degree: int) -> tuple[str, ...]:
    """Names of the attributes that splats of this SH degree have, in coding order."""
    absent = SH_REST_ATTRIBUTES[sh_degree:]
    return tuple(name for name in ATTRIBUTE_DIMS if name not in absent)


def split_attributes(splats: Splats) -> dict[str, F32]:
    """Attribute name -> values [n, dim]."""
    n = len(splats)
    out = {
        "scale": splats.log_scales,
        "rotation_real": splats.quats[:, :1],
        "rotation_imag": splats.quats[:, 1:],
        "opacity": splats.logit_opacities.reshape(n, 1),
        "sh0": splats.sh0,
    }
    for degree in range(1, splats.sh_degree + 1):
        band = splats.sh_rest[:, SH_REST_OF_DEGREE[degree - 1] : SH_REST_OF_DEGREE[degree]]
        out[f"sh{degree}"] = band.reshape(n, band.shape[1] * 3)
    return out


def join_attributes(means: F32, values: Mapping[str, F32]) -> Splats:
    """Inverse of :func:`split_attributes`; rotations come out unit with w >= 0.

    Raises :class:`DecodeError` if one is missing.
    """
    n = len(means)
    degree = sum(name in values for name in SH_REST_ATTRIBUTES)
    missing = [name for name in attributes_of_degree(degree) if name not in values]
    if missing:
        raise DecodeError(
            f"attribute {missing[0]!r} is missing; a splat needs {', '.join(attributes_of_degree(degree))}"
        )
    bands = [values[name].reshape(n, ATTRIBUTE_DIMS[name] // 3, 3) for name in SH_REST_ATTRIBUTES[:degree]]
    return Splats(
        means=means,
        quats=unit_quaternions(np.concatenate([values["rotation_real"], values["rotation_imag"]], axis=1)),
        log_scales=values["scale"],
        logit_opacities=np.ascontiguousarray(values["opacity"][:, 0]),
        sh0=values["sh0"],
        sh_rest=np.concatenate(bands, axis=1) if bands else np.zeros((n, 0, 3), np.float32),
    )


def unit_quaternions(quats: F32) -> F32:
    """Quaternions [n, 4] made unit with w >= 0; those without a direction become the identity."""
    norms = np.sqrt(np.einsum("ij,ij->i", quats, quats))
    lost = norms < 1e-12
    sign = np.where(quats[:, 0] < 0, np.float32(-1.0), np.float32(1.0))
    out = quats * (sign / np.where(lost, np.float32(1.0), norms))[:, None]
    out[lost] = (1.0, 0.0, 0.0, 0.0)
    return np.ascontiguousarray(out, dtype=np.float32)
