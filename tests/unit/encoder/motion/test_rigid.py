"""Rigid motion of runs of splats."""

import numpy as np
import pytest

from cags_common.motion.apply import rotate
from cags_encoder.motion.rigid import block_quaternions, carried, rigid_blocks


def turned(points: np.ndarray, axis: tuple[float, float, float], degrees: float) -> np.ndarray:
    half = np.radians(degrees) / 2
    quat = np.concatenate([[np.cos(half)], np.sin(half) * np.asarray(axis) / np.linalg.norm(axis)])
    return rotate(np.tile(quat, (len(points), 1)), points)


@pytest.mark.parametrize("degrees", [0.0, 1.0, 60.0, 179.0])
def test_a_body_that_turns_and_shifts_is_found(degrees: float) -> None:
    random = np.random.default_rng(1)
    anchors = random.normal(size=(64, 3))
    moved = turned(anchors, (1, 2, 3), degrees) + np.array([0.5, -2.0, 7.0])
    blocks = rigid_blocks(anchors, moved[None], np.ones(64), 64, 1e-4)
    points, _ = carried(blocks, anchors)
    assert np.abs(points[0] - moved).max() < 0.02  # Gibbs vectors are in 1/4096, and grow towards half a turn


def test_each_run_moves_by_itself_and_weights_decide() -> None:
    random = np.random.default_rng(2)
    anchors = random.normal(size=(100, 3))
    moved = anchors.copy()
    moved[:50] += (1, 0, 0)
    moved[50:] += (0, 3, 0)
    moved[99] += 100.0
    weights = np.ones(100)
    weights[99] = 1e-12
    points, _ = carried(rigid_blocks(anchors, moved[None], weights, 50, 1e-4), anchors)
    assert np.abs(points[0][:99] - moved[:99]).max() < 1e-2


def test_points_in_one_place_and_on_a_line_stay_finite() -> None:
    for anchors in (np.zeros((8, 3)), np.linspace(0, 1, 8)[:, None] * (1.0, 1.0, 0.0)):
        blocks = rigid_blocks(anchors, np.stack([anchors + 1, anchors * 2]), np.ones(8), 4, 1e-3)
        points, turns = carried(blocks, anchors)
        assert np.isfinite(points).all() and np.isfinite(turns).all()


def test_block_quaternions_are_unit() -> None:
    quats = block_quaternions(np.array([[0, 0, 0], [4096, -9000, 12], [2**25, 0, 0]], np.int32))
    assert np.allclose(np.linalg.norm(quats, axis=1), 1.0)
