"""Whatever bytes come, the decoder gives a picture, None, or a DecodeError."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cags_common.errors import DecodeError
from cags_common.video.h264 import H264Decoder, H264Encoder
from support.mutation import mutate

_IMAGE = np.linspace(0, 1, 32 * 32 * 3, dtype=np.float32).reshape(32, 32, 3)
_UNIT = H264Encoder(32, 32, 30).encode(_IMAGE)


def decode_or_refuse(data: bytes) -> bool:
    """Whether a picture came of it."""
    decoder = H264Decoder(max_pixels=64 * 64)
    try:
        picture = decoder.decode(data)
    except DecodeError:
        return False
    assert picture is None or (picture.ndim == 3 and np.isfinite(picture).all())
    return picture is not None


def fuzz(cases: int, seed: int) -> int:
    """Decode ``cases`` damaged access units; how many gave a picture all the same."""
    return sum(decode_or_refuse(mutate(_UNIT, np.random.default_rng((seed, case)))) for case in range(cases))


def test_damaged_units() -> None:
    assert 0 < fuzz(500, seed=1) < 500


@pytest.mark.nightly
@pytest.mark.timeout(3600)
def test_damaged_units_at_length() -> None:
    fuzz(100_000, seed=2)


@settings(max_examples=80)
@given(st.binary(max_size=300))
def test_noise(data: bytes) -> None:
    decode_or_refuse(data)


@settings(max_examples=80)
@given(st.lists(st.tuples(st.integers(0, len(_UNIT) - 1), st.integers(0, 255)), max_size=6), st.integers(0, len(_UNIT)))
def test_damaged_and_cut_units(changes: list[tuple[int, int]], keep: int) -> None:
    damaged = bytearray(_UNIT)
    for at, value in changes:
        damaged[at] = value
    decode_or_refuse(bytes(damaged[:keep]))
