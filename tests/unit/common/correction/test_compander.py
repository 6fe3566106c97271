"""The compander: odd, undone, and with a none that 8-bit video carries exactly."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_common.correction import compand, expand
from cags_common.correction.compander import SPAN, STILL, ZERO
from cags_common.video.colour import Chroma, rgb_of_ycbcr, ycbcr_of_planes
from cags_common.video.h264 import H264Decoder, H264Encoder

F = np.float32


@given(st.floats(-1, 1), st.floats(0.01, 1.0))
def test_it_is_odd_and_undone(lack: float, knee: float) -> None:
    coded = compand(np.array([lack, -lack]), knee)
    assert ((coded >= 1 / 219 - 1e-12) & (coded <= 1 + 1e-12)).all()
    assert coded.sum() == pytest.approx(2 * ZERO)
    undone = expand(coded, knee)[0]
    assert undone == pytest.approx(lack, abs=1e-9) or (undone == 0 and abs(coded[0] - ZERO) <= STILL)


@given(st.floats(0, 1), st.floats(0, 1), st.floats(0.01, 1.0))
def test_it_rises(a: float, b: float, knee: float) -> None:
    low, high = sorted((a, b))
    np.testing.assert_array_less(expand(np.array([low]), knee), expand(np.array([high]), knee) + 1e-12)


def test_codes_beyond_the_range_are_the_largest_differences() -> None:
    np.testing.assert_allclose(expand(np.array([0.0, 1.0, -3.0, 7.0]), 0.1), [-1, 1, -1, 1], atol=1e-12)
    np.testing.assert_allclose(compand(np.array([-2.0, 2.0]), 0.1), [ZERO - SPAN, ZERO + SPAN], atol=1e-12)


@pytest.mark.parametrize("chroma", Chroma)
def test_none_decodes_to_exactly_none(chroma: Chroma) -> None:
    planes = np.full((3, 16, 16) if chroma is Chroma.FULL else (24, 16), 128, np.uint8)
    planes.reshape(-1)[:256] = 126
    assert not expand(rgb_of_ycbcr(ycbcr_of_planes(planes, chroma)), 0.05).any()


def test_none_comes_through_h264_exactly() -> None:
    encoder, decoder = H264Encoder(64, 48, 30, crf=20, chroma=Chroma.FULL), H264Decoder()
    still = np.full((48, 64, 3), compand(np.zeros(1), 0.1)[0], F)
    for _ in range(3):
        decoded = decoder.decode(encoder.encode(still))
        assert decoded is not None
        assert not expand(decoded, 0.1).any()
