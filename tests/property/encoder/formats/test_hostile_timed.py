"""Whatever bytes come, a 4D file gives frames of checked splats or one line of SceneError, in bounded memory."""

import tracemalloc
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cags_common.errors import SceneError
from cags_encoder.formats.spacetime_ply import parse_spacetime_ply
from cags_encoder.formats.splatv import HEAD, RECORD, parse_splatv
from support.mutation import mutate
from support.timed_files import spacetime_ply_bytes, splatv_bytes, timed_splats

PARSERS = {"spacetime": parse_spacetime_ply, "splatv": parse_splatv}
ORIGINALS = {"spacetime": spacetime_ply_bytes(timed_splats(40)), "splatv": splatv_bytes(timed_splats(40))}


def sampled_or_refused(name: str, data: bytes) -> bool:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            timed = PARSERS[name](data, "f")
            for time in (0.0, 0.5, 0.98):
                rows = timed.alive(time)
                splats = timed.at(time, rows if len(rows) else timed.brightest(time), "f")
                assert all(np.isfinite(array).all() for _, array in splats.arrays())
        except SceneError as error:
            assert "\n" not in str(error)
            assert str(error).startswith("f: ")
            return False
    return True


def fuzz(name: str, cases: int, seed: int) -> int:
    """Parse ``cases`` damaged files; how many were still readable."""
    damaged = (mutate(ORIGINALS[name], np.random.default_rng((seed, case))) for case in range(cases))
    return sum(sampled_or_refused(name, data) for data in damaged)


@pytest.mark.parametrize("name", PARSERS)
def test_damaged_files(name: str) -> None:
    assert 50 < fuzz(name, 1_500, seed=0) < 1_450  # both paths are walked


@pytest.mark.nightly
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", PARSERS)
def test_damaged_files_at_length(name: str) -> None:
    fuzz(name, 100_000, seed=2)


@pytest.mark.parametrize("name", PARSERS)
@given(data=st.binary(max_size=400))
def test_any_bytes(name: str, data: bytes) -> None:
    sampled_or_refused(name, data)
    sampled_or_refused(name, ORIGINALS[name][:200] + data)


@settings(max_examples=50)
@given(words=st.lists(st.integers(0, 2**32 - 1), min_size=16, max_size=16), row=st.integers(0, 39))
def test_any_record(words: list[int], row: int) -> None:
    data = bytearray(ORIGINALS["splatv"])
    first = HEAD.size + HEAD.unpack_from(data)[1] + 3 + row * RECORD.itemsize
    data[first : first + RECORD.itemsize] = np.array(words, "<u4").tobytes()
    sampled_or_refused("splatv", bytes(data))


@pytest.mark.parametrize("name", PARSERS)
def test_claims_are_checked_before_memory_is_taken(name: str) -> None:
    data = ORIGINALS[name]
    claimed = data.replace(b"vertex 40", b"vertex 19000000").replace(b'"size": 65536', b'"size": 640000000')
    assert claimed != data
    tracemalloc.start()
    assert not sampled_or_refused(name, claimed)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 4 << 20
