"""Splats by id: bit-identical rows are found, and the table grows."""

from __future__ import annotations

import numpy as np

from cags_common.splats import Splats
from cags_encoder.tracks.rows import SplatTable, identical_rows, same_bits, same_rows
from support.raster_scenes import random_splats

SPLATS = random_splats(12, degree=1, seed=6)


def with_row(splats: Splats, row: int, name: str) -> Splats:
    arrays = {key: array.copy() for key, array in splats.arrays()}
    arrays[name].reshape(len(splats), -1)[row, -1] += 1
    return Splats(**arrays)


def test_any_bit_makes_a_row_differ() -> None:
    for name, array in SPLATS.arrays():
        if array.size:
            assert np.flatnonzero(~same_rows(SPLATS, with_row(SPLATS, 5, name))).tolist() == [5]
    zeros = np.zeros((2, 0, 3), np.float32)
    assert same_bits(zeros, zeros).all()
    assert not same_bits(np.float32([[0.0]]), np.float32([[-0.0]])).any(), "bits, not values"


def test_equal_splats_are_found_in_any_order_the_first_with_the_first() -> None:
    order = np.random.default_rng(7).permutation(12)
    rows, others = identical_rows(SPLATS, SPLATS.take(order))
    assert np.array_equal(order[others], rows) and len(rows) == 12
    twice = SPLATS.take(np.array([3, 3, 4]))
    rows, others = identical_rows(twice, SPLATS.take(np.array([3, 8, 3])))
    assert sorted(zip(rows.tolist(), others.tolist(), strict=True)) == [(0, 0), (1, 2)]
    assert len(identical_rows(SPLATS, with_row(SPLATS, 2, "sh_rest"))[0]) == 11


def test_a_table_grows_replaces_and_knows_who_is_alive() -> None:
    table = SplatTable(SPLATS)
    ids = np.array([2, 20])
    more = random_splats(2, degree=1, seed=8)
    assert table.holds(ids).tolist() == [True, False]
    assert table.differs(ids, more, ["means"]).tolist() == [True, True]
    table.put(ids, more)
    assert table.capacity == 21
    assert table.holds(np.array([2, 11, 12, 20, 99])).tolist() == [True, True, False, True, False]
    assert not table.differs(ids, more, ["means", "sh_rest"]).any()
    assert np.array_equal(table.take(ids).means, more.means)
    assert np.array_equal(table.take(np.array([3])).quats, SPLATS.quats[3:4])
