"""Entropy coding by static tables: what goes in comes out, and what is damaged is refused."""

from __future__ import annotations

import numpy as np
import pytest

from cags_common.coding import rans
from cags_common.errors import DecodeError


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
