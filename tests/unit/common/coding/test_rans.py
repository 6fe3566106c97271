"""Entropy coding by static tables: what goes in comes out, and what is damaged is refused."""

from __future__ import annotations

import numpy as np
import pytest

from cags_common.coding import rans
from cags_common.errors import DecodeError


def counts_of(**symbols: int) -> np.ndarray:
    counts = np.zeros(256, np.int64)
    for name, count in symbols.items():
        counts[int(name[1:])] = count
    return counts


def test_every_symbol_that_occurs_has_a_chance_however_rare() -> None:
    counts = np.ones(256, np.int64)
    counts[7] = 10**12
    frequencies = rans.Table.of(counts).frequencies
    assert frequencies.min() == 1 and frequencies.sum() == rans.TOTAL


@pytest.mark.parametrize(
    "counts",
    [counts_of(), counts_of(s0=1), counts_of(s255=1), counts_of(s3=1, s4=10**15), np.full(256, 3), np.arange(256)],
)
def test_frequencies_add_up_and_only_what_never_occurs_has_none(counts: np.ndarray) -> None:
    frequencies = rans.Table.of(counts).frequencies
    assert frequencies.sum() == rans.TOTAL
    if counts.any():
        assert ((frequencies > 0) == (counts[: len(frequencies)] > 0)).all()
        assert not counts[len(frequencies) :].any()


def test_runs_come_back_as_they_went_in() -> None:
    random = np.random.default_rng(1)
    symbols = random.geometric(0.3, 30_000).clip(0, 255).astype(np.uint8)
    tables = random.integers(0, 5, len(symbols)).astype(np.uint8)
    runs = np.array([10, 0, 9_990, 1, 19_999])
    decoder = rans.decoder(rans.encode(tables, symbols, runs))
    back = [decoder.take(part) for part in np.split(tables, np.cumsum(runs)[:-1])]
    decoder.finish()
    assert np.array_equal(np.concatenate(back), symbols)


def test_nothing_is_a_few_bytes() -> None:
    nothing = np.zeros(0, np.uint8)
    data = rans.encode(nothing, nothing, np.zeros(0, np.int64))
    assert len(data) < 20
    rans.decoder(data).finish()


def test_too_many_tables_and_runs_that_do_not_fit_are_refused() -> None:
    one = np.zeros(1, np.uint8)
    with pytest.raises(ValueError, match="table 64 is asked for"):
        rans.encode(one + np.uint8(rans.MAX_TABLES), one, np.array([1]))
    with pytest.raises(ValueError, match="runs of 2"):
        rans.encode(one, one, np.array([2]))


def test_a_table_that_the_data_lacks_cannot_be_asked_for() -> None:
    one = np.zeros(1, np.uint8)
    with pytest.raises(DecodeError, match="is asked for"):
        rans.decoder(rans.encode(one, one, np.array([1]))).take(one + np.uint8(3))


def test_symbols_left_over_and_missing_ones_are_told() -> None:
    symbols = np.random.default_rng(1).integers(0, 200, 500).astype(np.uint8)
    data = rans.encode(np.zeros(500, np.uint8), symbols, np.array([500]))
    early = rans.decoder(data)
    early.take(np.zeros(400, np.uint8))
    with pytest.raises(DecodeError, match="does not end where"):
        early.finish()
    with pytest.raises(DecodeError, match="end too early"):
        rans.decoder(data).take(np.zeros(2_000, np.uint8))
