"""Fades, and the exponential and logarithm that they are made of."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import cags_kernels
from cags_common.motion.apply import Looks, MovingTile, Steps, move_rows
from cags_common.motion.chunk import Chunk
from cags_common.motion.fades import MOST_EXPONENT, exponential, faded, logarithm

SPAN = 8


@given(arrays(np.float64, 20, elements=st.floats(-MOST_EXPONENT, MOST_EXPONENT)))
def test_the_exponential_is_that_of_the_library_to_its_last_bits(values: np.ndarray) -> None:
    assert np.allclose(exponential(values), np.exp(values), rtol=4e-15, atol=0)


@given(arrays(np.float64, 20, elements=st.floats(1e-300, 1e300)))
def test_the_logarithm_is_that_of_the_library_to_its_last_bits(values: np.ndarray) -> None:
    assert np.allclose(logarithm(values), np.log(values), rtol=4e-15, atol=1e-15)


def test_exponents_are_held_where_results_are_normal_numbers() -> None:
    held = exponential(np.array([-np.inf, -1e9, 1e9, np.inf]))
    assert np.array_equal(held, exponential(np.array([-1, -1, 1, 1]) * MOST_EXPONENT))
    assert np.isfinite(held).all() and (held > 0).all()


def test_a_fade_multiplies_the_opacity_and_none_leaves_it_alone() -> None:
    fades = np.array([[2, 1.5], [2, np.inf]], np.float32)
    logits = np.array([0.3, 0.3], np.float32)
    opacity = np.exp(-0.5 * (3 / 1.5) ** 2) / (1 + np.exp(-0.3))
    found = faded(fades, 5.0, logits)
    assert found[0] == pytest.approx(np.log(opacity / (1 - opacity)), rel=1e-6)
    assert found[1] == logits[1]


@pytest.mark.skipif(not cags_kernels.native_available(), reason="the kernels are not built")
@given(
    arrays(np.float32, 70, elements=st.floats(-300, 300, width=32)),
    arrays(np.float32, 70, elements=st.one_of(st.just(np.inf), st.floats(0.125, 512, width=32))),
    arrays(np.float32, 70, elements=st.one_of(st.floats(-20, 20, width=32), st.floats(width=32, allow_nan=False))),
    st.floats(0, SPAN),
)
def test_the_kernel_has_the_same_bits(centres: np.ndarray, widths: np.ndarray, logits: np.ndarray, time: float) -> None:
    count = len(logits)
    chunk = Chunk((0, 0), SPAN, count, None, np.stack([centres, widths], axis=1), None, None, True)
    looks = Looks(np.zeros((count, 3), np.float32), np.tile(np.float32([1, 0, 0, 0]), (count, 1)), logits)
    tile = MovingTile(
        chunk, time, np.arange(count, dtype=np.int32), Steps(np.ones(count, np.float32), np.ones(count, np.float32))
    )
    ways = []
    for native in (True, False):
        into = Looks(*(np.empty_like(array) for array in (looks.means, looks.quats, logits)))
        move_rows([tile], looks, into, native=native)
        ways.append(into.logit_opacities.view(np.uint32))
    assert np.array_equal(*ways)
