"""Real spherical harmonics of degrees 1 to 3, with the signs and order of Kerbl et al. 2023."""

from __future__ import annotations

import numpy as np

from cags_common.geometry import F64

_C1 = 0.4886025119029199
_C2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
_C3 = (0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154, 1.445305721320277)


def harmonics(directions: F64, count: int) -> F64:
    """The first ``count`` (0, 3, 8 or 15) view-dependent harmonics [N, count] in unit ``directions`` [N, 3]."""
    x, y, z = directions.T
    xx, yy, zz = x * x, y * y, z * z
    basis = [-_C1 * y, _C1 * z, -_C1 * x]
    basis += [_C2[0] * x * y, -_C2[0] * y * z, _C2[1] * (2 * zz - xx - yy), -_C2[0] * x * z, _C2[2] * (xx - yy)]
    basis += [
        -_C3[0] * y * (3 * xx - yy),
        _C3[1] * x * y * z,
        -_C3[2] * y * (4 * zz - xx - yy),
        _C3[3] * z * (2 * zz - 3 * xx - 3 * yy),
        -_C3[2] * x * (4 * zz - xx - yy),
        _C3[4] * z * (xx - yy),
        -_C3[0] * x * (xx - 3 * yy),
    ]
    return np.stack(basis, axis=1)[:, :count]
