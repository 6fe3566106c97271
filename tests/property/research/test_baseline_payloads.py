"""Damaged tiles of the baseline codecs give splats or DecodeError, never more."""

from functools import cache

import numpy as np
import pytest

from cags_common.errors import DecodeError
from cags_encoder import EncodeSettings
from cags_research.codecs.density import DensityTileCodec
from cags_research.codecs.encoding.density import DensityCodec
from cags_research.codecs.encoding.video import VideoCodec
from cags_research.codecs.video import VideoTileCodec
from support.mutation import mutate
from support.splat_files import random_splats

CODECS = {"density": (DensityCodec, DensityTileCodec), "video": (VideoCodec, VideoTileCodec)}


@cache
def original(name: str) -> tuple[bytes, tuple[bytes, ...]]:
    splats = random_splats(50, 1)
    codec = CODECS[name][0](splats, EncodeSettings())
    payloads = codec.encode_tile(np.arange(0, 100, 2, dtype=np.int32), codec.quantise(splats), id_range=False)
    return codec.codebooks(), payloads


def fuzz(name: str, cases: int, seed: int) -> int:
    """Open ``cases`` damaged tiles; how many decoded all the same."""
    book, payloads = original(name)
    opener, read = CODECS[name][1](None, book), 0  # type: ignore[arg-type]
    for case in range(cases):
        rng = np.random.default_rng((seed, case))
        victim = int(rng.integers(len(payloads))) if case % 3 else 0
        damaged = [mutate(p, rng) if k == victim else p for k, p in enumerate(payloads)]
        try:
            state = opener.open_tile(damaged[0])
            for lod in {victim, 1} - {0}:
                state.add_layer(lod, damaged[lod])
            splats = state.dequantise()
        except DecodeError as error:
            assert "\n" not in str(error)
            continue
        assert len(splats) == len(state.ids) == len(state)
        read += 1
    return read


@pytest.mark.parametrize("name", CODECS)
def test_damaged_tiles(name: str) -> None:
    assert fuzz(name, 600, seed=1) < 600


@pytest.mark.nightly
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", CODECS)
def test_damaged_tiles_at_length(name: str) -> None:
    fuzz(name, 100_000, seed=2)
