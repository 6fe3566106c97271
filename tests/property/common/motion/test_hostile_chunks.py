"""Damaged chunks of motion, by the kernel and by the definition, give a chunk or one line of DecodeError."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import cags_kernels
from cags_common.errors import DecodeError
from cags_common.motion.chunk import ChunkDecoder, encode
from support.anchors import scattered
from support.mutation import mutate

LOOKS = scattered(24)


@cache
def original() -> tuple[bytes, ...]:
    rng = np.random.default_rng(0)
    time = np.linspace(0, 3, 9)[:, None, None]
    moves, turns = (np.sin(time * rng.uniform(0, 2, (24, 3 + more))) * 20 for more in (0, 1))
    lives = rng.integers(0, 9, 24).astype(np.uint8)
    return encode((5, 9), LOOKS, moves, turns, starts=True, lives=lives)


def reads(payloads: tuple[bytes, ...], *, native: bool) -> bool:
    try:
        decoder = ChunkDecoder(payloads[0], LOOKS, native=native)
        for payload in payloads[1:]:
            decoder.add_level(payload)
    except DecodeError as error:
        assert "\n" not in str(error)
        return False
    return True


def fuzz(cases: int, seed: int, *, native: bool) -> int:
    """Decode ``cases`` damaged chunks; how many were read all the same."""
    read = 0
    for case in range(cases):
        rng, whole = np.random.default_rng((seed, case)), original()
        victim = case % len(whole)
        damaged = tuple(mutate(payload, rng) if i == victim else payload for i, payload in enumerate(whole))
        read += reads(damaged, native=native)
    return read


NATIVE = pytest.param(True, marks=pytest.mark.skipif(not cags_kernels.native_available(), reason="needs the kernels"))


@pytest.mark.parametrize("native", [NATIVE, False])
def test_a_whole_chunk_is_read(native: bool) -> None:
    assert reads(original(), native=native)


@pytest.mark.parametrize(("native", "cases"), [pytest.param(True, 2_000, marks=NATIVE.marks), (False, 60)])
def test_damaged_chunks(native: bool, cases: int) -> None:
    assert fuzz(cases, seed=1, native=native) < cases


@pytest.mark.nightly
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("native", [NATIVE])
def test_damaged_chunks_at_length(native: bool) -> None:
    fuzz(100_000, seed=2, native=native)
