"""Frames cut into tiles: each splat once, neighbours together, ids ascending within a tile."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cags_encoder.tiling import corners, cut_tiles


class Rows:
    """Quantised splats that consist of their row numbers."""

    def __init__(self, rows: np.ndarray) -> None:
        self.rows = rows

    def take(self, rows: np.ndarray) -> Any:
        return Rows(self.rows[rows])


@pytest.mark.parametrize("id_range", [True, False])
def test_every_splat_is_in_one_tile_with_its_own_row(id_range: bool) -> None:
    random = np.random.default_rng(4)
    ids = np.arange(103) if id_range else random.choice(1000, 103, replace=False)
    means = random.normal(size=(103, 3)).astype(np.float32)
    tiles = cut_tiles(ids.astype(np.int64), means, Rows(np.arange(103)), largest=20, id_range=id_range)
    assert max(len(tile.ids) for tile in tiles) <= 20
    assert sorted(np.concatenate([tile.ids for tile in tiles])) == sorted(ids)
    for tile in tiles:
        assert (np.diff(tile.ids) > 0).all()
        assert np.array_equal(ids[tile.coded.rows], tile.ids)  # type: ignore[attr-defined]
        inside = means[tile.coded.rows]  # type: ignore[attr-defined]
        assert tile.bounds == corners(inside)
        assert (np.array(tile.bounds[0], np.float32) == inside.min(axis=0)).all()


def test_tiles_of_a_differential_frame_are_compact() -> None:
    corner = np.repeat(np.eye(3, dtype=np.float32) * 100, 10, axis=0)
    shuffled = np.random.default_rng(5).permutation(30)
    tiles = cut_tiles(np.arange(30), corner[shuffled], Rows(np.arange(30)), largest=10, id_range=False)
    assert [tile.bounds[0] == tile.bounds[1] for tile in tiles] == [True] * 3
