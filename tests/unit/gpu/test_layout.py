"""Numbers that the shaders take as integers mean what they were."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_gpu.layout import CHUNK, FIXED_RANGE_PX, VIEW, _fixed, _limbs, _mantissa

COORDINATES = st.floats(-1e30, 1e30, allow_nan=False)


@given(st.floats(-1, 1))
def test_limbs_are_a_number_of_48_bits(part: float) -> None:
    high, middle, low, negative = _limbs(part)
    assert max(high, middle, low) <= 0xFFFF
    value = (high << 32 | middle << 16 | low) / 2.0**47
    assert (-value if negative else value) == pytest.approx(part, abs=2.0**-48)


def test_a_focal_length_beyond_the_range_is_marked() -> None:
    assert _limbs(1.5) == (0, 0, 0, 1)


@given(COORDINATES)
def test_a_mantissa_is_the_whole_number(part: float) -> None:
    high, low, exponent, negative = _mantissa(part)
    value = math.ldexp(high << 32 | low, exponent - 2048 - 52)
    assert (-value if negative else value) == part
    assert high < 1 << 21


@given(st.floats(-FIXED_RANGE_PX + 1, FIXED_RANGE_PX - 1))
def test_fixed_coordinates_are_two_words_of_twos_complement(part: float) -> None:
    high, low = _fixed(part)
    whole = high << 32 | low
    assert (whole - (1 << 64) if whole >> 63 else whole) / 2.0**31 == pytest.approx(part, abs=2.0**-31)


def test_what_no_field_has_is_refused() -> None:
    with pytest.raises(KeyError, match="wrong"):
        CHUNK.pack(wrong=1)
    with pytest.raises(ValueError, match="size holds 2 numbers, not 3"):
        VIEW.pack(size=(1, 2, 3))
    assert CHUNK.pack(first=7) == (7).to_bytes(4, "little") + bytes(12)
