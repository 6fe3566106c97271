"""Tables of probabilities: what occurs has a chance, they come back as they were, and damage is told."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_common.coding.tables import HALVINGS, MAX_SYMBOLS, STEPS, TOTAL, Table, Tables, read_tables
from cags_common.errors import DecodeError


def counts_of(**symbols: int) -> np.ndarray:
    counts = np.zeros(256, np.int64)
    for name, count in symbols.items():
        counts[int(name[1:])] = count
    return counts


def several(seed: int, count: int) -> np.ndarray:
    """Counts [count, 256] of geometric symbols, some tables without any."""
    random = np.random.default_rng(seed)
    out = np.zeros((count, 256), np.int64)
    for row in out:
        drawn = random.geometric(random.uniform(0.02, 0.9), random.integers(0, 900)) - 1
        row[:] = np.bincount(drawn.clip(0, MAX_SYMBOLS - 1), minlength=256) * random.integers(0, 2)
    return out


def test_every_symbol_that_occurs_has_a_chance_however_rare() -> None:
    counts = np.ones(256, np.int64)
    counts[7] = 10**12
    frequencies = Table.of(counts).frequencies
    assert frequencies.min() >= 1
    assert frequencies.sum() == TOTAL


@pytest.mark.parametrize("steps", STEPS)
@pytest.mark.parametrize(
    "counts",
    [counts_of(), counts_of(s0=1), counts_of(s255=1), counts_of(s3=1, s4=10**15), np.full(256, 3), np.arange(256)],
)
def test_frequencies_add_up_and_only_what_never_occurs_has_none(counts: np.ndarray, steps: int) -> None:
    frequencies = Table.of(counts, steps).frequencies
    assert frequencies.sum() == TOTAL
    if counts.any():
        assert ((frequencies > 0) == (counts[: len(frequencies)] > 0)).all()
        assert not counts[len(frequencies) :].any()


@given(st.integers(0, 2**32 - 1), st.integers(1, 12))
def test_tables_come_back_as_they_were(seed: int, count: int) -> None:
    told = Tables.of(several(seed, count))
    data = told.to_bytes()
    back, size = read_tables(memoryview(data + b"what follows"), count)
    assert size == len(data)
    for table, expected in zip(back, told.each, strict=True):
        np.testing.assert_array_equal(table.frequencies, expected.frequencies)


def test_many_symbols_get_finer_tables_than_few() -> None:
    smooth = np.round(1e5 * 0.9 ** np.arange(256)).astype(np.int64)
    many, few = Tables.of(smooth[None]), Tables.of(smooth[None] // 5_000)
    assert many.tables[0].steps > few.tables[0].steps
    assert many.tables[0].cost(smooth) < 1.005 * _entropy(smooth)
    assert len(few.to_bytes()) < 12


def test_tables_that_are_alike_are_one() -> None:
    same = np.tile(counts_of(s0=80, s1=30, s2=9), (4, 1))
    assert Tables.of(same).lengths == [4]
    other = np.stack([same[0], 100 * counts_of(s200=900, s220=700)])
    assert Tables.of(other).lengths == [1, 1]


@pytest.mark.parametrize("form", [3, 7, 16, 255])
def test_unknown_forms_are_refused(form: int) -> None:
    with pytest.raises(DecodeError, match=f"form {form}"):
        read_tables(memoryview(bytes([form, 1, 0, 0])), 1)


def test_what_cannot_be_a_table_is_refused() -> None:
    data = Tables.of(several(3, 5)).to_bytes()
    for end in range(len(data)):
        with pytest.raises(DecodeError, match="cut short"):
            read_tables(memoryview(data[:end]), 5)
    with pytest.raises(DecodeError, match="first table"):
        read_tables(memoryview(bytes([0, 0])), 1)
    with pytest.raises(DecodeError, match="more than"):
        read_tables(memoryview(bytes([0, 1]) + b"\xff" * 40), 1)
    largest = 1 + HALVINGS
    nothing = [1] * (2 * largest - 1) + [0]  # from the largest weight to none
    with pytest.raises(DecodeError, match="nothing occurs"):
        read_tables(memoryview(bytes([0, 1]) + np.packbits(nothing, bitorder="little").tobytes()), 1)
    with pytest.raises(DecodeError, match=f"weight of {largest + 1}"):
        read_tables(memoryview(bytes([0, 1, 0b011])), 1)


def _entropy(counts: np.ndarray) -> float:
    used = counts[counts > 0]
    return float((used * np.log2(counts.sum() / used)).sum())
