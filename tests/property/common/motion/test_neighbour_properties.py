"""Neighbours of splats anywhere and of any size: finite fits of splats coded before, the same bits by the kernel."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import cags_kernels
from cags_common.motion.neighbours import Anchors, Neighbours, groups, relative
from support.anchors import KINDS, any_looks

native_only = pytest.mark.skipif(not cags_kernels.native_available(), reason="needs the native kernels")
SIZES = (0.0, 1e-45, 1e-30, 1e-3, 1.0, 1e30, 3e38)


@st.composite
def looks(draw: st.DrawFn) -> Anchors:
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    count = draw(st.one_of(st.integers(0, 20), st.integers(0, 700)))
    made = any_looks(random, count, draw(st.sampled_from(KINDS)))
    mixed = draw(st.lists(st.sampled_from(SIZES), max_size=3))
    if not mixed:
        return made
    places = random.choice(mixed, (count, 1)) * np.sign(made.positions) * random.choice([1, 0.5], (count, 3))
    units = random.choice(mixed, count)
    return Anchors(places.astype(np.float32), units.astype(np.float32), made.turns)


@given(looks())
@settings(max_examples=150, deadline=None)
def test_fits_are_finite_and_of_splats_that_are_coded_before(anchors: Anchors) -> None:
    check(anchors, Neighbours.of(anchors, native=False))


@native_only
@given(looks())
@settings(max_examples=300, deadline=None)
def test_so_they_are_by_the_kernel(anchors: Anchors) -> None:
    check(anchors, Neighbours.of(anchors, native=True))


def check(anchors: Anchors, near: Neighbours) -> None:
    number = np.empty(len(anchors), np.intp)
    for at, group in enumerate(groups(len(anchors))):
        number[group] = at
    assert np.isfinite(near.fits).all()
    counts = near.rows != np.arange(len(anchors))[:, None]
    assert (number[near.rows] < number[:, None])[counts].all()
    assert not near.fits[~counts].any()
    shares = near.fits[:, :, 0].sum(axis=1)
    assert (near.fits[:, :, 0] >= 0).all() and np.allclose(shares, number > 0, atol=1e-5)
    off = np.full((len(anchors), 3), 5000, np.float32)
    shift, _ = near.expected(off, np.ones(len(anchors), np.float32), np.flatnonzero(number > 0), 64)
    assert np.abs(shift - 5000).max(initial=0) <= 5, "what all do is expected of each"


@native_only
@given(looks())
@settings(max_examples=150, deadline=None)
def test_rows_and_fits_have_the_same_bits_by_the_kernel(anchors: Anchors) -> None:
    mine, theirs = (Neighbours.of(anchors, native=native) for native in (True, False))
    assert np.array_equal(mine.rows, theirs.rows)
    assert mine.fits.tobytes() == theirs.fits.tobytes()


@given(looks(), st.integers(0, 2**32 - 1), st.sampled_from([1.0, 1e3, 4e9]), st.integers(0, 12))
@settings(max_examples=80, deadline=None)
def test_what_is_expected_is_within_bounds_whatever_neighbours_are(
    anchors: Anchors, seed: int, size: float, power: int
) -> None:
    random = np.random.default_rng(seed)
    off = random.uniform(-size, size, (len(anchors), 4)).astype(np.float32)
    off[random.random(len(anchors)) < 0.3] = 0
    units, near = relative(anchors.moves), Neighbours.of(anchors, native=False)
    shift, spread = near.expected(off * units[:, None], units, np.arange(len(anchors)), 1 << power)
    assert shift.dtype == spread.dtype == np.int32
    assert np.abs(shift.astype(np.int64)).max(initial=0) <= 1 << 30
    assert spread.min(initial=0) >= 0 and spread.max(initial=0) <= 756
