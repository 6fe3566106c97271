"""Knots: what the samples before one lead to expect of it."""

from __future__ import annotations

import numpy as np
import pytest

from cags_common.motion.knots import END, MIDDLE, START, knots, predicted

SPANS = [2, 3, 5, 8, 13, 16, 64]


@pytest.mark.parametrize("curved", [False, True])
@pytest.mark.parametrize("span", SPANS)
def test_every_sample_is_coded_once_after_those_that_it_is_told_against(span: int, curved: bool) -> None:
    done: set[int] = set()
    for knot in knots(span, start=True, curved=curved):
        needed = {START: set(), END: {0}, MIDDLE: {knot.left, knot.right, knot.before, knot.after} - {-1}}[knot.kind]
        assert needed <= done and knot.at not in done
        done.add(knot.at)
    assert done == set(range(span + 1))


@pytest.mark.parametrize("curved", [False, True])
@pytest.mark.parametrize("span", SPANS)
def test_a_line_is_expected_as_it_is(span: int, curved: bool) -> None:
    line = np.arange(span + 1, dtype=np.int32)[:, None] * np.array([[7, -640_001]], np.int32) + 5
    for knot in knots(span, start=True, curved=curved):
        if knot.kind == MIDDLE:
            assert np.array_equal(predicted(line, knot), line[knot.at])


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
