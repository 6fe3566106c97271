"""What differences of splats show."""

from __future__ import annotations

import numpy as np
import pytest

from cags_encoder.tracks.effect import of_axes


def area(scales: np.ndarray, ways: np.ndarray) -> np.ndarray:
    """Areas [n] of ellipsoids with axes ``scales`` [3] seen along ``ways`` [n, 3], in pi."""
    others = scales[[1, 0, 0]] * scales[[2, 2, 1]]
    return np.sqrt(np.square(ways * others).sum(axis=1))


@pytest.mark.parametrize("ratio", [0.01, 0.03, 0.1, 0.3])
def test_axes_of_flat_splats_count_by_what_is_drawn_of_them(ratio: float) -> None:
    ways = np.random.default_rng(4).normal(size=(200_000, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    scales, small = np.array([1.0, 1.0, ratio]), 1e-4
    shown = []
    for axis in range(3):
        longer = scales * np.exp(small * (np.arange(3) == axis))
        change = np.log(area(longer, ways) / area(scales, ways)) / small
        shown.append(np.sqrt(np.square(change).mean()))
    weights = of_axes(np.log(scales)[None])[0]
    assert np.all(weights[:2] == 1)
    assert weights[2] == pytest.approx(shown[2] / shown[0], rel=0.25)


def test_order_size_and_roundness_do_not_matter() -> None:
    log_scales = np.array([[-9, -3, -2], [-2, -9, -3], [-3, -3, -3], [-500, 500, 0]], np.float32)
    weights = of_axes(log_scales)
    assert np.allclose(weights[0], weights[1][[1, 2, 0]])
    assert np.all(weights[2] == 1)
    assert np.isfinite(weights).all() and weights[3, 0] < 1e-12
    assert len(of_axes(np.zeros((0, 3), np.float32))) == 0
