import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_common.errors import DecodeError
from cags_common.tiles.contexts import (
    MAX_CODE_BITS,
    MAX_PREFIX_BITS,
    SYMBOLS_A_LANE,
    ContextModel,
    can_be_modelled,
    coding_runs,
    counted,
    decode_codes,
    encode_codes,
    nearest,
    with_layer,
)

SHAPES = [(bits, prefix) for bits in range(1, MAX_CODE_BITS + 1) for prefix in range(MAX_PREFIX_BITS + 1)]


def model(bits: int, prefix_bits: int, seed: int) -> ContextModel:
    random = np.random.default_rng(seed)
    weights = random.integers(0, 256, ContextModel.shape_of(bits, prefix_bits)) * (random.random() < 0.9)
    return ContextModel(bits, prefix_bits, weights.astype(np.uint8))


def likely(
    made: ContextModel, prefixes: np.ndarray | None, near: np.ndarray, random: np.random.Generator
) -> np.ndarray:
    """Codes drawn by the model's own probabilities, in the order of coding."""
    codes = np.zeros(len(near), np.uint8)
    for rows in coding_runs(len(near)):
        chances = made.frequencies[made.contexts_at(rows, codes, prefixes, near)].cumsum(axis=1)
        codes[rows] = (chances <= random.integers(0, 4096, len(chances))[:, None]).sum(axis=1)
    return codes


@given(
    st.integers(0, 2 * SYMBOLS_A_LANE + 300) | st.integers(0, 20),
    st.sampled_from(SHAPES),
    st.integers(0, 2**31 - 1),
    st.booleans(),
)
def test_codes_come_back_and_both_implementations_agree(
    count: int, shape: tuple[int, int], seed: int, by_chance: bool
) -> None:
    random, (bits, prefix_bits) = np.random.default_rng(seed), shape
    near = nearest(random.integers(0, 8, (count, 3)).astype(np.float32))
    prefixes = random.integers(0, 1 << prefix_bits, count).astype(np.uint8) if prefix_bits else None
    made = model(bits, prefix_bits, seed)
    codes = random.integers(0, 1 << bits, count).astype(np.uint8)
    if not by_chance:
        codes = likely(made, prefixes, near, random)
    data = encode_codes(made, codes, prefixes, near, native=False)
    assert encode_codes(made, codes, prefixes, near, native=True) == data
    assert len(data) <= (count * bits + 7) // 8
    for native in (False, True):
        back, packed = decode_codes(data, made, prefixes, near, native=native)
        assert np.array_equal(back, codes)
        assert np.array_equal(packed.unpack(count), codes)


@given(st.integers(1, 600), st.integers(0, 2**31 - 1), st.data())
def test_damaged_codes_are_refused_alike_or_are_codes(count: int, seed: int, data: st.DataObject) -> None:
    random = np.random.default_rng(seed)
    near, made = nearest(random.integers(0, 8, (count, 3)).astype(np.float32)), model(4, 0, seed)
    payload = bytearray(encode_codes(made, likely(made, None, near, random), None, near))
    end = data.draw(st.integers(0, len(payload)))
    del payload[end:]
    for at in data.draw(st.lists(st.integers(0, max(end - 1, 0)), max_size=3)):
        if payload:
            payload[at] ^= 1 << data.draw(st.integers(0, 7))
    found = []
    for native in (False, True):
        try:
            codes = decode_codes(bytes(payload), made, None, near, native=native)[0]
            assert codes.max(initial=0) < 16
            found.append(codes.tobytes())
        except DecodeError as error:
            found.append(str(error))
    assert found[0] == found[1]


@given(st.integers(0, 700), st.integers(1, 2**20), st.integers(0, 2**31 - 1))
def test_near_ones_are_the_two_nearest_of_those_before(count: int, size: int, seed: int) -> None:
    cells = np.random.default_rng(seed).integers(0, size, (count, 3)).astype(np.float32)
    near = nearest(cells, native=True)
    assert np.array_equal(near, nearest(cells, native=False))
    order = np.concatenate([np.zeros(0, np.int64), *(np.arange(count)[rows] for rows in coding_runs(count))])
    assert sorted(order) == list(range(count))
    when = np.empty(count, np.int64)
    when[order] = np.arange(count)
    for i in range(1, count):
        step = i & -i
        known = [at for at in (i - step, i + step, i - 3 * step, i + 3 * step) if 0 <= at < count]
        away = [float(np.square(cells[at].astype(np.float64) - cells[i]).sum()) for at in known]
        by_distance = [at for _, at in sorted(zip(away, known, strict=True), key=lambda pair: pair[0])]
        assert near[i].tolist() == [*by_distance, -1][:2]
        assert all(when[at] < when[i] for at in near[i] if at >= 0)


def test_neighbours_that_agree_save_bits() -> None:
    random = np.random.default_rng(0)
    cells = np.sort(random.integers(0, 4096, 4000))[:, None].repeat(3, axis=1).astype(np.float32)
    base, near = (cells[:, 0] // 256).astype(np.uint8), nearest(cells)
    finer = (cells[:, 0] // 64).astype(np.uint8) & 3
    for codes, prefixes, bits, prefix_bits in ((base, None, 4, 0), (finer, base, 2, 4)):
        made = ContextModel.of(counted(model(bits, prefix_bits, 0), codes, prefixes, near), bits, prefix_bits)
        assert len(encode_codes(made, codes, prefixes, near)) < 0.2 * len(codes) * bits / 8


@given(st.sampled_from(SHAPES), st.integers(0, 2**31 - 1))
def test_frequencies_add_up_and_none_is_zero(shape: tuple[int, int], seed: int) -> None:
    made = model(*shape, seed)
    assert (made.frequencies.sum(axis=1) == 4096).all()
    assert made.frequencies.min() >= 1
    counts = np.random.default_rng(seed).integers(0, 1000, made.weights.shape) ** 2
    learnt = ContextModel.of(counts, *shape)
    assert (learnt.frequencies.argmax(axis=1) == learnt.weights.argmax(axis=1)).all()


def test_a_model_of_nothing_holds_all_alike() -> None:
    made = ContextModel.of(np.zeros(ContextModel.shape_of(2, 4)), 2, 4)
    assert np.ptp(made.frequencies.astype(int)) <= 1


def test_only_short_codes_have_models() -> None:
    assert [can_be_modelled((4, 2, 2, 2, 2), layer) for layer in range(5)] == [True, True, True, False, False]
    assert not can_be_modelled((8,), 0)
    for bits, prefix_bits in itertools.product((2, 4), (0, 4)):
        with pytest.raises(DecodeError, match="probabilities"):
            ContextModel(bits, prefix_bits, np.zeros((3, 4), np.uint8))


def test_prefixes_grow_by_a_layer() -> None:
    assert with_layer(np.array([1, 15], np.uint8), np.array([3, 0], np.uint8), 2).tolist() == [7, 60]
