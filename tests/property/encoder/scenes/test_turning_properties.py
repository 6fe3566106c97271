"""Rotations of many splats and of their harmonics agree with each other."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from cags_common import so3
from cags_common.geometry import F64, rotation_matrix
from cags_encoder.scenes import rotations
from cags_encoder.scenes.harmonics import basis, lobe, rotate_rest

SEEDS = st.integers(0, 10_000)
DEGREES = st.integers(1, 3)


def unit(rng: np.random.Generator, *shape: int) -> F64:
    v = rng.normal(size=shape)
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


@given(SEEDS)
def test_matrices_agree_with_single_ones_and_back(seed: int) -> None:
    quats = unit(np.random.default_rng(seed), 5, 4)
    matrices = so3.matrices(quats)
    w, x, y, z = quats[2].tolist()
    np.testing.assert_allclose(matrices[2], rotation_matrix((w, x, y, z)), atol=1e-12)
    np.testing.assert_allclose(np.abs(np.sum(rotations.of_matrices(matrices) * quats, axis=1)), 1, atol=1e-9)


@given(st.sampled_from([0, 1, 2]))
def test_half_turns_are_found(axis: int) -> None:
    diagonal = -np.ones(3)
    diagonal[axis] = 1
    quat = rotations.of_matrices(np.diag(diagonal)[None])[0]
    np.testing.assert_allclose(np.abs(quat), np.eye(4)[axis + 1], atol=1e-9)


@given(SEEDS)
def test_products_compose(seed: int) -> None:
    a, b = unit(np.random.default_rng(seed), 2, 6, 4)
    product = so3.matrices(so3.multiply(a, b))
    np.testing.assert_allclose(product, so3.matrices(a) @ so3.matrices(b), atol=1e-12)


@given(SEEDS)
def test_frames_lie_along_their_axes(seed: int) -> None:
    x, y = unit(np.random.default_rng(seed), 2, 4, 3)
    matrices = so3.matrices(rotations.of_frames(x, y))
    np.testing.assert_allclose(matrices[..., 0], x, atol=1e-8)
    np.testing.assert_allclose(np.sum(matrices[..., 2] * y, axis=1), 0, atol=1e-8)


@given(SEEDS, DEGREES)
def test_turned_harmonics_show_in_turned_directions_what_they_showed_before(seed: int, degree: int) -> None:
    rng = np.random.default_rng(seed)
    matrices = so3.matrices(unit(rng, 4, 4))
    rest = rng.normal(size=(4, (degree + 1) ** 2 - 1, 3)).astype(np.float32)
    directions = unit(rng, 4, 3)
    before = np.einsum("nk,nkc->nc", basis(directions, degree)[:, 1:], rest)
    turned = np.einsum("nij,nj->ni", matrices, directions)
    after = np.einsum("nk,nkc->nc", basis(turned, degree)[:, 1:], rotate_rest(rest, matrices))
    np.testing.assert_allclose(before, after, atol=2e-6)


def test_the_basis_is_orthonormal_and_in_the_files_order() -> None:
    k = np.arange(20_000) + 0.5
    z, azimuth = 1 - 2 * k / 20_000, np.pi * (1 + 5**0.5) * k
    ring = np.sqrt(1 - z * z)
    values = basis(np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z], axis=1), 3)
    np.testing.assert_allclose(4 * np.pi * values.T @ values / len(k), np.eye(16), atol=1e-3)
    x, y, z_ = 0.48, 0.6, 0.64
    expected = [-0.4886025 * y, 0.4886025 * z_, -0.4886025 * x, 1.0925484 * x * y, -1.0925484 * y * z_]
    np.testing.assert_allclose(basis(np.array([x, y, z_]), 2)[1:6], expected, atol=1e-6)


@given(SEEDS, DEGREES)
def test_a_lobe_peaks_with_one_at_its_axis(seed: int, degree: int) -> None:
    rng = np.random.default_rng(seed)
    axis = unit(rng, 1, 3)
    values = basis(np.concatenate([axis, unit(rng, 200, 3)]), degree) @ lobe(axis, 24.0, degree)[0]
    assert abs(values[0] - 1) < 1e-9
    assert values.max() <= 1 + 1e-9
