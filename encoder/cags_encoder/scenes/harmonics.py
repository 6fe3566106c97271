"""Real spherical harmonics up to degree 3, with the signs and order of 3D Gaussian files.

A splat's colour in the viewing direction d (unit, from the camera to the splat) is 0.5 plus the sum of its coefficients
times :func:`basis` (Kerbl et al. 2023; constants after Sloan 2008).
"""

from __future__ import annotations

from functools import cache

import numpy as np

from cags_common.geometry import F32, F64
from cags_common.splats import SH_C0, SH_REST_OF_DEGREE


def basis(directions: F64, degree: int) -> F64:
    """Values of the harmonics for unit ``directions`` [..., 3]: [..., (degree + 1)^2], the constant one first."""
    x, y, z = np.moveaxis(directions, -1, 0)
    bands = [np.full_like(x, SH_C0)]
    if degree >= 1:
        c = np.sqrt(3 / (4 * np.pi))
        bands += [-c * y, c * z, -c * x]
    if degree >= 2:
        c = np.sqrt(15 / (4 * np.pi))
        bands += [c * x * y, -c * y * z, c / np.sqrt(12) * (3 * z * z - 1), -c * x * z, c / 2 * (x * x - y * y)]
    if degree >= 3:
        c, d, e = np.sqrt(35 / (32 * np.pi)), np.sqrt(105 / (4 * np.pi)), np.sqrt(21 / (32 * np.pi))
        bands += [
            -c * y * (3 * x * x - y * y),
            d * x * y * z,
            -e * y * (5 * z * z - 1),
            np.sqrt(7 / (16 * np.pi)) * z * (5 * z * z - 3),
            -e * x * (5 * z * z - 1),
            d / 2 * z * (x * x - y * y),
            -c * x * (x * x - 3 * y * y),
        ]
    return np.stack(bands, axis=-1)


@cache
def lobe_bands(sharpness: float, degree: int) -> tuple[float, ...]:
    """Factors of the bands of ``max(0, cos)^sharpness``: its Legendre integrals (Funk-Hecke), scaled to peak 1.

    The higher bands are damped (Hann's window) so that a truncated lobe rings less.
    """
    cosine, weight = np.polynomial.legendre.leggauss(128)
    lobe = weight * np.maximum(cosine, 0.0) ** sharpness
    legendre = np.polynomial.legendre.legvander(cosine, degree)
    window = 0.5 + 0.5 * np.cos(np.pi * np.arange(degree + 1) / (degree + 2))
    bands = window * (lobe @ legendre)
    peak = np.sum(bands * (2 * np.arange(degree + 1) + 1)) / (4 * np.pi)
    return tuple(float(v) for v in bands / peak)


def lobe(axes: F64, sharpness: float, degree: int) -> F64:
    """Coefficients [N, (degree + 1)^2] of a lobe ``max(0, d . axis)^sharpness`` about each unit axis [N, 3]."""
    per_band = lobe_bands(sharpness, degree)
    coefficients: F64 = basis(axes, degree) * np.repeat(per_band, [2 * band + 1 for band in range(degree + 1)])
    return coefficients


def rotate_rest(sh_rest: F32, rotations: F64) -> F32:
    """View-dependent coefficients [N, K, 3] of splats rotated by ``rotations`` [3, 3] or [N, 3, 3].

    The basis at rotated directions is a linear combination of the basis within each band. Least squares over
    sufficiently many directions gives the combination exactly.
    """
    degree = SH_REST_OF_DEGREE.index(sh_rest.shape[1])
    if degree == 0:
        return sh_rest
    directions = _directions()
    turned_back = directions @ rotations  # rows d^T R = (R^T d)^T: [M, 3] or [N, M, 3]
    mixing = np.linalg.pinv(basis(directions, degree)[:, 1:]) @ basis(turned_back, degree)[..., 1:]
    return np.ascontiguousarray(mixing @ sh_rest.astype(np.float64), dtype=np.float32)


@cache
def _directions() -> F64:
    """Forty evenly distributed directions (golden spiral)."""
    k = np.arange(40) + 0.5
    z, azimuth = 1 - 2 * k / 40, np.pi * (1 + 5**0.5) * k
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z], axis=1)
