"""Knots of a span: each sample once, after those that predict it, and the same bits from every decoder."""

from __future__ import annotations

import numpy as np
import pytest

from cags_common.motion.knots import END, FRACTION_BITS, MIDDLE, knots, predicted, quantised

SPANS = [1, 2, 3, 7, 16, 33]


@pytest.mark.parametrize("span", SPANS)
@pytest.mark.parametrize("start", [True, False])
@pytest.mark.parametrize("curved", [True, False])
def test_each_sample_is_coded_once_after_its_neighbours(span: int, start: bool, curved: bool) -> None:
    known = set() if start else {0}
    for knot in knots(span, start=start, curved=curved):
        assert knot.at not in known
        assert {knot.left, knot.right, knot.before, knot.after} - {knot.at, -1} <= known
        assert knot.parent in known | {-1}
        known.add(knot.at)
    assert known == set(range(span + 1))


@pytest.mark.parametrize("span", SPANS)
@pytest.mark.parametrize("curved", [True, False])
def test_a_line_needs_nothing_but_its_end(span: int, curved: bool) -> None:
    rise = np.array([5 << FRACTION_BITS, -640_001], np.int32)
    samples = np.arange(span + 1, dtype=np.int32)[:, None] * rise
    for knot in knots(span, start=False, curved=curved):
        guess = predicted(samples, knot)
        assert (guess == samples[knot.at]).all() or knot.kind == END


def test_a_guess_is_rounded_down_on_both_sides_of_zero() -> None:
    middle = knots(2, start=False)[1]
    samples = np.array([[0, 0], [0, 0], [1, -1]], np.int32)
    assert predicted(samples, middle).tolist() == [0, -1]


def test_residuals_round_to_the_nearest_unit_outside_of_the_dead_zone() -> None:
    wanted, guess = np.array([0.49, 0.51, -0.51, 1.4, -1.6]), np.zeros(5)
    assert quantised(wanted, guess, 0.0).tolist() == [0, 1, -1, 1, -2]
    assert quantised(wanted, guess, 0.25).tolist() == [0, 0, 0, 1, -1]
    assert quantised(wanted, guess + 1, 0.0).tolist() == [-1, 0, -2, 0, -3]


@pytest.mark.parametrize("span", SPANS)
def test_curves_follow_a_cubic_between_neighbours_and_a_parabola_at_the_ends(span: int) -> None:
    time = np.arange(span + 1, dtype=np.float64)
    cubic, parabola = 40 * time**3 - 900 * time**2 + 77 * time, 300 * time**2 - 5_000 * time
    samples = np.stack([cubic, parabola], axis=1).astype(np.int32)
    for knot in knots(span, start=True, curved=True):
        if knot.kind == MIDDLE and (knot.before >= 0 or knot.after >= 0):
            off = np.abs(predicted(samples, knot).astype(np.int64) - samples[knot.at])
            largest = np.abs(samples).max(axis=0) / (1 << 12)  # of what weights are rounded to
            assert off[1] <= 2 + largest[1]
            assert off[0] <= 2 + largest[0] or knot.before < 0 or knot.after < 0
