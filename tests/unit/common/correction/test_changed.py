"""Cells in which changed splats are seen."""

from __future__ import annotations

import numpy as np
import pytest

from cags_common.correction import Spheres, changed_cells, veto_shape
from support.corrections import F, camera, view

CAMERA = camera((320, 240))
WALL = np.full((240, 320), 4.0, F)


def at(u: float, v: float, z: float) -> tuple[float, float, float]:
    i = CAMERA.intrinsics
    return (u - i.cx_px) / i.fx_px * z, (v - i.cy_px) / i.fy_px * z, z


def cells(positions: list[tuple[float, float, float]], radii: list[float], depth: np.ndarray = WALL) -> np.ndarray:
    return changed_cells(Spheres(np.array(positions, F).reshape(-1, 3), np.array(radii, F)), CAMERA, depth)


def test_nothing_changed_is_no_veto_and_the_grid_is_the_corrections() -> None:
    out = cells([], [])
    assert out.shape == veto_shape(CAMERA) == (15, 20)
    assert out.dtype == F
    assert not out.any()


def test_a_small_splat_marks_its_cell_alone() -> None:
    out = cells([at(5 * 16 + 8, 3 * 16 + 8, 3.0)], [0.001])
    assert out[3, 5] == 1
    assert out.sum() == 1


def test_a_large_splat_marks_all_that_it_covers() -> None:
    radius_px = 40
    out = cells([at(160, 120, 3.0)], [radius_px / CAMERA.intrinsics.fx_px * 3.0])
    rows, columns = np.nonzero(out)
    assert rows.min() <= (120 - radius_px) // 16
    assert rows.max() >= (120 + radius_px) // 16
    assert columns.min() <= (160 - radius_px) // 16
    assert columns.max() >= (160 + radius_px) // 16
    assert out.sum() < 60


def test_what_lies_behind_the_view_is_not_seen_and_through_holes_all_is() -> None:
    hidden = at(160, 120, 8.0)
    assert not cells([hidden], [0.05]).any()
    depth = WALL.copy()
    depth[118, 158] = np.inf
    assert cells([hidden], [0.05], depth).any()
    assert cells([at(160, 120, 4.2)], [0.05]).any(), "within the tolerance"


def test_outside_the_image_or_behind_the_camera_nothing_is_seen() -> None:
    assert not cells([(0, 0, -3.0), at(-500, 120, 3.0), at(160, 5000, 3.0)], [0.1, 0.1, 0.1]).any()


def test_around_the_camera_all_is_seen() -> None:
    assert cells([(0.0, 0.0, 0.1)], [1.0]).all()


def test_many_splats_of_all_sizes_agree_with_one_by_one() -> None:
    rng = np.random.default_rng(0)
    positions = rng.uniform((-3, -3, -1), (3, 3, 8), (300, 3)).astype(F)
    radii = (10 ** rng.uniform(-3, 0, 300)).astype(F)
    depth = view(CAMERA, holes=0.1).depth
    together = changed_cells(Spheres(positions, radii), CAMERA, depth)
    alone = [changed_cells(Spheres(positions[i : i + 1], radii[i : i + 1]), CAMERA, depth) for i in range(300)]
    np.testing.assert_array_equal(together, np.maximum.reduce(alone))
    assert 0 < together.mean() <= 1


def test_an_empty_view_hides_nothing() -> None:
    assert cells([at(168, 120, 50.0)], [0.05], np.full((240, 320), np.inf, F)).sum() == 1


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="depth of shape"):
        changed_cells(Spheres(np.zeros((1, 3), F), np.ones(1, F)), CAMERA, np.ones((3, 3), F))
    with pytest.raises(ValueError, match="positions of shape"):
        Spheres(np.zeros((2, 3), F), np.ones(1, F))
