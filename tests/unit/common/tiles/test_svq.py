import gzip
import tracemalloc
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_common.coding.packing import gzip_bytes
from cags_common.errors import DecodeError
from cags_common.tiles.contexts import ContextModel
from cags_common.tiles.svq import Codebook, CodebookSet
from support.codec_scenes import books, on_a_grid


def test_prefix_and_layers_take_a_code_apart_and_together() -> None:
    book = books((4, 2, 1))["scale"]
    codes = np.arange(128, dtype=np.uint32)
    base, first, second = (book.layer(codes, layer) for layer in range(3))
    assert np.array_equal((base << 3) | (first << 1) | second, codes)
    assert np.array_equal(book.prefix(codes, 2), codes >> 1)


def test_lookup_reads_the_table_of_the_depth() -> None:
    book = books((4, 2))["sh0"]
    codes = np.array([0, 5, 63], np.uint32)
    assert np.array_equal(book.lookup(codes, 2), book.tables[1][codes])
    assert np.array_equal(book.lookup(book.prefix(codes, 1), 1), book.tables[0][codes >> 2])


def test_codebooks_survive_serialising_and_equal_ones_give_equal_bytes() -> None:
    given = books((4, 2, 2))
    data = given.to_bytes()
    back = CodebookSet.from_bytes(data)
    assert back.attributes == given.attributes
    for a, b in zip(given, back, strict=True):
        assert a.layer_bits == b.layer_bits
        assert all(np.array_equal(x, y) for x, y in zip(a.tables, b.tables, strict=True))
    assert back.to_bytes() == data == books((4, 2, 2)).to_bytes()


def test_entries_that_repeat_their_parent_cost_nothing() -> None:
    random = np.random.default_rng(0)
    base = on_a_grid(random.normal(size=(16, 3)))
    repeated = CodebookSet({"scale": Codebook("scale", (4, 8), (base, np.repeat(base, 256, axis=0)))})
    alone = CodebookSet({"scale": Codebook("scale", (4,), (base,))})
    assert len(repeated.to_bytes()) < len(alone.to_bytes()) + 80  # of 25 kB of zeros


def test_the_deepest_codebook_allowed_works() -> None:
    given = books((8, 8), attributes=("opacity",))
    back = CodebookSet.from_bytes(given.to_bytes())["opacity"]
    assert back.lookup(np.array([2**16 - 1], np.uint32), 2)[0, 0] == given["opacity"].tables[1][-1, 0]


@pytest.mark.parametrize("layer_bits", [(), (0, 2), (9,), (8, 8, 1)])
def test_layers_outside_the_bounds_are_refused(layer_bits: tuple[int, ...]) -> None:
    with pytest.raises(DecodeError, match="outside the allowed range"):
        Codebook("scale", layer_bits, tuple(np.zeros((1 << b, 3), np.float32) for b in np.cumsum(layer_bits)))


def test_a_missing_attribute_is_named() -> None:
    with pytest.raises(DecodeError, match="no codebook for attribute 'sh3'"):
        books()["sh3"]


def test_many_small_codebooks_that_unpack_to_gigabytes_are_refused_unread() -> None:
    """A book of sixteen layers of zeros has 11 MB of tables and takes almost no bytes: 255 of them come in one blob."""
    book = bytes([9, 16, 0, *[1] * 16]) + b"".join(bytes(21 + (42 << layer)) for layer in range(1, 17))
    data = b"CAGSCB02" + gzip_bytes(bytes([255]) + 2 * book)
    tracemalloc.start()
    try:
        with pytest.raises(DecodeError, match="255 of them"):
            CodebookSet.from_bytes(data)
        _, most_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(data) < 30_000
    assert most_bytes < 50e6


@given(st.integers(-60, 60), st.integers(1, 2**15 - 1), st.integers(0, 2**31 - 1))
def test_tables_on_steps_come_back_bit_by_bit(exponent: int, most: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    base = np.ldexp(random.integers(-most, most + 1, (16, 3)).astype(np.float32), exponent)
    finer = np.repeat(base, 4, axis=0) + np.ldexp(random.integers(-64, 65, (64, 3)).astype(np.float32), exponent)
    given_book = Codebook("scale", (4, 2), (base, finer))
    back = CodebookSet.from_bytes(CodebookSet({"scale": given_book}).to_bytes())["scale"]
    for table, wanted in zip(back.tables, given_book.tables, strict=True):
        assert table.tobytes() == (wanted + np.float32(0)).tobytes()


def test_spreads_come_back_and_others_are_not_written() -> None:
    base = np.zeros((2, 3), np.float32)
    offsets = on_a_grid(np.random.default_rng(0).normal(size=(4, 3)))
    spreads = np.array([[2.0**-14, 1.125, 0.875], [30720, 13, 2.0**-17]], np.float32)
    book = Codebook("scale", (1, 2), (base, offsets), 1, spreads)
    back = CodebookSet.from_bytes(CodebookSet({"scale": book}).to_bytes())["scale"]
    assert back.spreads is not None
    assert back.spreads.tobytes() == spreads.tobytes()
    for value in (1.0625, -1.0, 1e6, 2.0**-18):
        wrong = Codebook("scale", (1, 2), (base, offsets), 1, np.where(spreads == 13, np.float32(value), spreads))
        with pytest.raises(ValueError, match="spreads have more bits"):
            CodebookSet({"scale": wrong}).to_bytes()


@pytest.mark.parametrize("value", [1e-4, 40000.5, 1 / 3])
def test_a_table_that_is_not_on_steps_is_not_written(value: float) -> None:
    table = np.array([[0], [value], [65536 - 2.0**-7], [1]], np.float32)
    with pytest.raises(ValueError, match="'opacity': a table is not on steps"):
        CodebookSet({"opacity": Codebook("opacity", (2,), (table,))}).to_bytes()


def serialised(data: bytes, change: Callable[[bytes], bytes]) -> bytes:
    """Codebooks whose body, inside its gzip frame, is changed."""
    magic = data[: data.index(b"\x1f\x8b")]
    return magic + gzip_bytes(change(gzip.decompress(data[len(magic) :])))


def infinite(body: bytes) -> bytes:
    """The steps of the only column are 2**127."""
    return body[:5] + bytes([127]) + body[6:]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda body: body + b"\0", "1 bytes too many"),
        (lambda body: body[:-1], "cut short"),
        (infinite, "holds a value that is not finite"),
        (lambda body: bytes([2]) + body[1:] * 2, "an attribute appears twice"),
        (lambda body: body[:1] + b"\xff" + body[2:], "attribute number 255 is unknown"),
        (lambda body: body[:4] + b"\0" + body[5:], "outside the allowed range"),
    ],
)
def test_codebooks_that_are_not_whole_are_refused(change: Callable[[bytes], bytes], words: str) -> None:
    values = np.arange(16, dtype=np.float32)[:, None]
    data = CodebookSet({"opacity": Codebook("opacity", (4,), (values,))}).to_bytes()
    assert CodebookSet.from_bytes(serialised(data, lambda body: body)).to_bytes() == data
    with pytest.raises(DecodeError, match=words):
        CodebookSet.from_bytes(serialised(data, change))


@given(st.integers(1, 5), st.booleans(), st.integers(0, 2**31 - 1))
def test_a_truncated_codebook_reads_shorter_codes_as_the_whole_one_does(
    layers: int, two_trees: bool, seed: int
) -> None:
    random = np.random.default_rng(seed)
    bits, tree = (3, 1, 2, 2, 1), 2 if two_trees else 5
    sizes = [*np.cumsum(bits[:tree]), *np.cumsum(bits[tree:])]
    tables = tuple(on_a_grid(random.normal(size=(1 << int(size), 3))) for size in sizes)
    spreads = (random.integers(1, 16, (1 << sum(bits[:tree]), 3)) / np.float32(16)) if two_trees else None
    whole = Codebook("scale", bits, tables, tree if two_trees else None, spreads)
    cut = whole.truncated(layers)
    codes = whole.prefix(random.integers(0, 1 << sum(bits), 50).astype(np.uint32), layers)
    assert cut.enhancement_layers == layers - 1
    for held in range(1, layers + 1):
        shorter = cut.prefix(codes, held)
        np.testing.assert_array_equal(cut.lookup(shorter, held), whole.lookup(shorter, held))
    again = CodebookSet.from_bytes(CodebookSet({"scale": cut}).to_bytes())["scale"]
    np.testing.assert_array_equal(again.lookup(codes, layers), whole.lookup(codes, layers))


def modelled(layer_bits: tuple[int, ...], layers: tuple[int, ...], seed: int = 0) -> Codebook:
    """Zeros, with models of these layers."""
    random, models = np.random.default_rng(seed), list[ContextModel | None]()
    for layer in range(max(layers) + 1):
        bits, below = layer_bits[layer], sum(layer_bits[:layer])
        weights = random.integers(0, 256, ContextModel.shape_of(bits, below)).astype(np.uint8)
        models.append(ContextModel(bits, below, weights) if layer in layers else None)
    tables = tuple(np.zeros((1 << int(size), 3), np.float32) for size in np.cumsum(layer_bits))
    return Codebook("scale", layer_bits, tables, models=tuple(models))


@pytest.mark.parametrize("layers", [(0,), (1,), (0, 2), (0, 1, 2)])
def test_models_travel_with_the_codebooks(layers: tuple[int, ...]) -> None:
    book = modelled((4, 2, 2, 2), layers)
    back = CodebookSet.from_bytes(CodebookSet({"scale": book}).to_bytes())["scale"]
    for layer in range(4):
        made, read = book.model(layer), back.model(layer)
        assert (made is None) == (read is None)
        assert made is None or read is None or np.array_equal(made.frequencies, read.frequencies)
    assert book.truncated(1).begins(back)
    assert (book.truncated(1).model(0) is None) == (0 not in layers)
    assert not modelled((4, 2, 2, 2), layers, 1).truncated(max(layers) + 1).begins(back)


def test_models_of_long_codes_are_refused() -> None:
    short = modelled((4, 2, 2, 2), (2,))
    with pytest.raises(DecodeError, match="layer 0 cannot have such a model"):
        Codebook("scale", (4,), (np.zeros((16, 3), np.float32),), models=(short.model(2),))
    with pytest.raises(DecodeError, match="models of 2 layers"):
        Codebook("scale", (4,), (np.zeros((16, 3), np.float32),), models=(None, None))
    data = CodebookSet({"scale": modelled((4, 2, 2, 2), (0,))}).to_bytes()
    for bit in (3, 7):
        with pytest.raises(DecodeError, match=f"layer {bit} cannot have such a model"):
            CodebookSet.from_bytes(serialised(data, partial(_only, layer=bit)))


def _only(body: bytes, layer: int) -> bytes:
    """The body of one book whose model is said to be of ``layer``."""
    at = len(body) - 32 * 16 - 1
    assert body[at] == 1
    return body[:at] + bytes([1 << layer]) + body[at + 1 :]
