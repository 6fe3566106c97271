"""What neighbours lead to expect of a splat: a linear field through those that are coded before it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import cags_kernels
from cags_common.motion.neighbours import (
    COUNT,
    LEAST_UNIT,
    MOST_SHIFT,
    MOST_SPREAD,
    RIDGE,
    SPREAD,
    STRIDES,
    WINDOW,
    Anchors,
    Neighbours,
    groups,
    relative,
)
from support.anchors import scattered, together

BOTH = [False, True] if cags_kernels.native_available() else [False]
COUNTS = [1, 2, 3, 8, 9, 255, 256, 257, 700]
UNIT = 64


def of_one_size(positions: np.ndarray) -> Anchors:
    ones = np.ones(len(positions), np.float32)
    return Anchors(np.ascontiguousarray(positions, dtype=np.float32), ones, ones)


def expected_by_last(anchors: Anchors, off: np.ndarray, unit: int = UNIT) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of the last group; their shifts and spreads where all others are ``off`` [n, parts] metres."""
    rows = groups(len(anchors))[-1]
    near = Neighbours.of(anchors, native=False)
    return rows, *near.expected(off.astype(np.float32), relative(anchors.moves), rows, unit)


# ------------------------------------------------------------------------------------------------------ who they are


@pytest.mark.parametrize("splats", [0, *COUNTS])
def test_groups_hold_every_splat_once(splats: int) -> None:
    assert len(groups(splats)) == len(STRIDES)
    assert sorted(np.concatenate(groups(splats)).tolist()) == list(range(splats))


@pytest.mark.parametrize("native", BOTH)
@pytest.mark.parametrize("splats", COUNTS)
def test_neighbours_come_before_the_splat_in_the_coding_order(splats: int, native: bool) -> None:
    near, number = Neighbours.of(scattered(splats), native=native), np.empty(splats, np.intp)
    for at, group in enumerate(groups(splats)):
        number[group] = at
    missing = near.fits[:, :, 0] == 0
    assert (near.rows[missing] == np.nonzero(missing)[0]).all(), "who has too few stands in for them"
    earlier = number[near.rows] < number[:, None]
    assert earlier[~missing].all()
    assert missing[number == 0].all() and not missing[number > 0, 0].any()
    assert not near.fits[missing].any()


@pytest.mark.parametrize("native", BOTH)
def test_they_are_the_nearest_within_the_window_nearest_first(native: bool) -> None:
    anchors = scattered(700)
    near = Neighbours.of(anchors, native=native)
    at = anchors.positions.astype(np.float64)
    for stride in STRIDES[1:]:
        for row in groups(700)[STRIDES.index(stride)][:20]:
            first = row - stride
            window = np.arange(first - 2 * stride * (WINDOW - 1), first + 2 * stride * WINDOW + 1, 2 * stride)
            window = window[(window >= 0) & (window < 700)]
            nearest = window[np.argsort(np.square(at[window] - at[row]).sum(axis=1), kind="stable")][:COUNT]
            assert near.rows[row, : len(nearest)].tolist() == nearest.tolist()


@pytest.mark.parametrize("native", BOTH)
def test_shares_are_the_inverse_of_distance_and_unit_and_add_up_to_one(native: bool) -> None:
    anchors = scattered(300)
    near, at = Neighbours.of(anchors, native=native), anchors.positions.astype(np.float64)
    last = groups(300)[-1]
    away = at[near.rows[last]] - at[last][:, None]
    weights = 1 / (np.linalg.norm(away, axis=2) * anchors.moves[near.rows[last]])
    shares = weights / weights.sum(axis=1, keepdims=True)
    assert np.allclose(near.fits[last, :, 0], np.where(near.rows[last] == last[:, None], 0, shares), atol=1e-3)


@pytest.mark.skipif(not cags_kernels.native_available(), reason="compares the kernel with numpy")
@pytest.mark.parametrize("splats", [0, *COUNTS])
def test_the_kernel_finds_the_same_bits(splats: int) -> None:
    for anchors in (scattered(splats), together(splats), of_one_size(np.arange(3 * splats).reshape(-1, 3) // 7)):
        mine, theirs = (Neighbours.of(anchors, native=native) for native in (True, False))
        assert np.array_equal(mine.rows, theirs.rows)
        assert mine.fits.dtype == theirs.fits.dtype == np.float32
        assert mine.fits.tobytes() == theirs.fits.tobytes()


PLACES = {
    "one splat": np.ones((1, 3)),
    "two splats": np.array([[0, 0, 0], [1, 2, 3]]),
    "all at one place": np.full((600, 3), 0.25),
    "pairs at one place": np.repeat(np.random.default_rng(1).normal(size=(300, 3)), 2, axis=0),
    "half at one place": np.random.default_rng(2).normal(size=(600, 3)) * (np.arange(600) % 2)[:, None],
    "two of three at one place": np.array([[2, 1, 1], [0, 0, 0], [0, 0, 0]]),
    "in a line": np.arange(600)[:, None] * np.array([1.0, -2.0, 0.5]),
    "in a plane": np.random.default_rng(3).normal(size=(600, 3)) * np.array([1, 1, 0]),
    "on a coarse grid": np.random.default_rng(4).integers(0, 4, (600, 3)) / 4,
    "far from the origin": np.random.default_rng(5).normal(size=(600, 3)) + 1e6,
    "huge": np.random.default_rng(6).normal(size=(600, 3)) * 1e30,
    "tiny": np.random.default_rng(7).normal(size=(600, 3)) * 1e-30,
}


@pytest.mark.parametrize("native", BOTH)
@pytest.mark.parametrize("positions", PLACES.values(), ids=PLACES.keys())
def test_wherever_splats_are_the_fits_are_finite_and_what_all_do_is_expected(
    positions: np.ndarray, native: bool
) -> None:
    anchors = of_one_size(positions)
    near = Neighbours.of(anchors, native=native)
    assert np.isfinite(near.fits).all()
    rows = np.arange(len(positions))
    has = near.fits[:, 0, 0] > 0
    off = np.full((len(positions), 3), 5000, np.float32)
    shift, spread = near.expected(off, relative(anchors.moves), rows, UNIT)
    assert np.abs(shift[has] - 5000).max(initial=0) <= 1 and spread[has].max(initial=0) <= 1
    assert not shift[~has].any() and not spread[~has].any()


# ------------------------------------------------------------------------------------------------- what they lead to


def test_without_anything_off_nothing_is_expected() -> None:
    _, shift, spread = expected_by_last(scattered(300), np.zeros((300, 4)))
    assert shift.shape == spread.shape == (150, 4)
    assert not shift.any() and not spread.any()


def fields(anchors: Anchors, random: np.random.Generator) -> np.ndarray:
    """A linear field [n, 3] of the positions."""
    return anchors.positions.astype(np.float64) @ random.normal(size=(3, 3)) * 1e5 + random.normal(size=3) * 1e5


def test_the_value_of_the_fit_is_that_of_a_ridge_regression_and_its_explained_share() -> None:
    random, anchors = np.random.default_rng(8), of_one_size(np.random.default_rng(8).normal(size=(300, 3)))
    off = fields(anchors, random) + random.normal(size=(300, 3)) * 2e4
    rows, shift, spread = expected_by_last(anchors, off, 1 << 13)
    near, at = Neighbours.of(anchors, native=False), anchors.positions.astype(np.float64)
    for number, row in enumerate(rows):
        values, shares = off[near.rows[row]], near.fits[row, :, :1].astype(np.float64)
        away = at[near.rows[row]] - at[row]
        place = away / (shares[:, 0] * np.linalg.norm(away, axis=1)).sum()
        middle, mean = (shares * place).sum(axis=0), (shares * values).sum(axis=0)
        centred = place - middle
        slopes = np.linalg.solve((shares * centred).T @ centred + RIDGE * np.eye(3), (shares * centred).T @ values)
        level = mean - middle @ slopes
        missed = values - (level + place @ slopes)
        explained = max(0.0, 1 - (shares * missed**2).sum() / (shares * values**2).sum())
        assert shift[number] == pytest.approx(level * explained, rel=1e-3, abs=5)
        least = np.minimum((shares * np.abs(missed)).sum(axis=0) * SPREAD / (1 << 13), MOST_SPREAD)
        assert spread[number] == pytest.approx(least, rel=1e-3, abs=1)


def test_a_linear_field_is_expected_far_better_than_by_the_mean_of_neighbours() -> None:
    random, anchors = np.random.default_rng(9), of_one_size(np.random.default_rng(9).uniform(-1, 1, (4000, 3)))
    off = fields(anchors, random)
    rows, shift, _ = expected_by_last(anchors, off)
    near = Neighbours.of(anchors, native=False)
    mean = (off[near.rows[rows]] * near.fits[rows, :, :1]).sum(axis=1)
    inside = (np.abs(anchors.positions[rows]) < 0.8).all(axis=1)
    wrong, by_mean = (np.abs(guess - off[rows])[inside].mean() for guess in (shift, mean))
    assert wrong < 0.5 * by_mean


def test_two_that_agree_are_followed_and_two_that_disagree_are_not() -> None:
    line = of_one_size([[0, 0, 0], [1, 0, 0], [2, 0, 0]])
    for ends, wanted in (((1000, 1000), 1000), ((1000, -1000), 0)):
        off = np.zeros((3, 1))
        off[[0, 2], 0] = ends
        rows, shift, _ = expected_by_last(line, off)
        assert (rows.tolist(), shift.tolist()) == ([1], [[wanted]])


def test_neighbours_that_disagree_lead_to_expect_little_and_that_with_little_certainty() -> None:
    random, anchors = np.random.default_rng(10), scattered(2000)
    off = 1000.0 * random.choice([-1, 1], (2000, 3))
    unit = relative(anchors.moves)
    _, shift, spread = expected_by_last(anchors, off)
    off_in_units = np.abs(shift) * unit[groups(2000)[-1]][:, None]
    assert np.median(off_in_units) < 250
    _, _, agreed = expected_by_last(anchors, np.full((2000, 3), 1000.0))
    assert np.median(spread) == MOST_SPREAD and np.median(agreed) == 0


def test_neighbours_of_other_sizes_are_compared_in_metres() -> None:
    two = replace(of_one_size([[0, 0, 0], [1, 0, 0]]), moves=np.float32([8, 2]))
    assert relative(two.moves).tolist() == [1.0, 0.25]
    off = np.array([[40.0], [0.0]])  # 40 units of the large splat
    _, shift, spread = expected_by_last(two, off)
    assert (shift.tolist(), spread.tolist()) == ([[160]], [[0]]), "160 units of the small one"


def test_the_smaller_of_two_at_one_distance_counts_for_more() -> None:
    three = replace(of_one_size([[0, 0, 0], [1, 0, 0], [0, 0, 0]]), moves=np.float32([3, 3, 1]))
    shares = Neighbours.of(three, native=False).fits[1, :, 0]
    assert shares[:2] == pytest.approx([0.25, 0.75])


def test_units_count_in_parts_of_the_largest() -> None:
    assert relative(np.float32([0, 2, 8])).tolist() == [float(LEAST_UNIT), 0.25, 1]
    assert relative(np.zeros(3, np.float32)).tolist() == [1, 1, 1]
    assert relative(np.zeros(0, np.float32)).tolist() == []


def test_what_is_beyond_fixed_point_is_not_expected() -> None:
    two = of_one_size([[0, 0, 0], [1, 0, 0]])
    for far, wanted in ((float(MOST_SHIFT), 0), (-float(MOST_SHIFT), 0), (2.0**29, 2**29), (-(2.0**29), -(2**29))):
        _, shift, _ = expected_by_last(two, np.array([[far], [0.0]]))
        assert shift.tolist() == [[wanted]]


def test_the_spread_is_in_parts_of_the_unit_and_bounded() -> None:
    line, off = of_one_size([[0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.array([[1000.0], [0.0], [-1000.0]])
    spreads = [int(expected_by_last(line, off, unit)[2][0, 0]) for unit in (1, 64, 4096)]
    left = 1000 * (1 - 1 / (1 + RIDGE))
    assert spreads == [MOST_SPREAD, int(left * SPREAD / 64), int(left * SPREAD / 4096)]


# ---------------------------------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize("column", ["positions", "moves", "turns"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_not_finite_are_refused(column: str, bad: float) -> None:
    looks = scattered(5)
    looks.check()
    damaged = getattr(looks, column).copy()
    damaged.reshape(-1)[3] = bad
    with pytest.raises(ValueError, match=r"^positions or units of the looks are not finite$"):
        replace(looks, **{column: damaged}).check()


@pytest.mark.parametrize("column", ["moves", "turns"])
def test_arrays_that_do_not_fit_each_other_are_refused(column: str) -> None:
    with pytest.raises(ValueError, match=r"units for 5 splats"):
        replace(scattered(5), **{column: np.ones(4, np.float32)}).check()


def test_some_of_the_looks_keep_what_is_theirs() -> None:
    looks, rows = scattered(9), np.array([7, 2])
    for some in (looks.take(rows), looks.take(np.isin(np.arange(9), rows))):
        assert len(some) == 2
    assert np.array_equal(looks.take(rows).positions, looks.positions[rows])
    assert np.array_equal(looks.take(rows).moves, looks.moves[rows])
    assert np.array_equal(looks.take(rows).turns, looks.turns[rows])
