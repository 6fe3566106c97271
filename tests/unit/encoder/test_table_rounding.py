import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_common.tiles.svq import Codebook, CodebookSet
from cags_encoder.quantiser.rounding import on_steps, rounded_spreads


@given(st.floats(-6, 4), st.floats(-12, 2), st.floats(-9, 1), st.integers(0, 2**31 - 1))
def test_rounded_tables_can_be_written_and_are_as_near_as_what_they_leave(
    size: float, split: float, left: float, seed: int
) -> None:
    random = np.random.default_rng(seed)
    base = 10**size * random.normal(size=(16, 3))
    finer = np.repeat(base, 4, axis=0) + 10.0 ** (size + split) * random.normal(size=(64, 3))
    deviations = np.full(3, 10.0 ** (size + left))
    rounded = on_steps([base, finer], [deviations, deviations])
    book = Codebook("scale", (4, 2), tuple(rounded))
    back = CodebookSet.from_bytes(CodebookSet({"scale": book}).to_bytes())["scale"]
    for table, wanted, kept in zip((base, finer), rounded, back.tables, strict=True):
        assert kept.tobytes() == (wanted + np.float32(0)).tobytes()
        limit = np.clip(table, -6e4, 6e4)
        finest = np.abs(limit).max(axis=0) * 2.0**-14
        assert (np.abs(wanted - limit) <= np.maximum(deviations / 6, finest)).all()


def test_few_values_take_few_bits() -> None:
    """A thousand entries whose cells are as wide as half their distances: three bits each, not sixteen."""
    random = np.random.default_rng(0)
    base = random.normal(size=(256, 15))
    finer = np.repeat(base, 4, axis=0) + 0.4 * random.normal(size=(1024, 15))
    rounded = on_steps([base, finer], [np.full(15, 0.9), np.full(15, 0.8)])
    coarse = CodebookSet({"sh2": Codebook("sh2", (8,), (rounded[0],))}).to_bytes()
    whole = CodebookSet({"sh2": Codebook("sh2", (8, 2), tuple(rounded))}).to_bytes()
    assert (len(whole) - len(coarse)) * 8 / finer.size < 4.2


@pytest.mark.parametrize("value", [1e-9, 2.0**-14, 0.3, 1.0, 1000.0, 1e9])
def test_spreads_keep_three_bits(value: float) -> None:
    (spread,) = rounded_spreads(np.array([value]))
    assert spread == pytest.approx(np.clip(value, 2.0**-14, 3e4), rel=2.0**-4)
    offsets = np.zeros((2, 1), np.float32)
    book = Codebook("opacity", (1, 1), (offsets, offsets), 1, np.full((2, 1), spread))
    assert CodebookSet.from_bytes(CodebookSet({"opacity": book}).to_bytes())["opacity"].spreads[0, 0] == spread
