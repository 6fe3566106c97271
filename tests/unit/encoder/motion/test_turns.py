"""Rotations of splats over frames."""

import numpy as np
from scipy.spatial.transform import Rotation

from cags_common.motion.apply import product
from cags_encoder.motion.turns import relative_turns


def wxyz(rotation: Rotation) -> np.ndarray:
    return np.roll(rotation.as_quat(), 1, axis=-1)


def axes(quats: np.ndarray) -> np.ndarray:
    """Outer products of each Gaussian's axes [n, 3, 3, 3], which are independent of their signs."""
    columns = Rotation.from_quat(np.roll(quats, -1, axis=-1)).as_matrix()
    return np.einsum("nik,njk->nkij", columns, columns)


def test_a_spin_through_many_turns_has_no_jump() -> None:
    first = wxyz(Rotation.random(5, random_state=0))
    spin = Rotation.from_rotvec(np.outer(np.radians(np.arange(0, 900, 25.0)), (0, 0, 1)))
    frames = np.stack([product(np.tile(wxyz(turn), (5, 1)), first) for turn in spin])
    frames *= np.where(frames[:, :, :1] < 0, -1.0, 1.0)  # as in files
    turns = relative_turns(frames, first)
    assert ((turns[1:] * turns[:-1]).sum(axis=2) > 0.7).all()
    for turn, frame in zip(turns, frames, strict=True):
        assert np.allclose(axes(product(turn, first)), axes(frame), atol=1e-9)


def test_another_way_to_write_the_same_gaussian_is_no_turn() -> None:
    first = wxyz(Rotation.random(50, random_state=1))
    halves = np.eye(4)[np.arange(50) % 4]
    frames = -product(first, halves)[None]
    assert np.allclose(relative_turns(frames, first), [[[1.0, 0, 0, 0]]], atol=1e-12)
