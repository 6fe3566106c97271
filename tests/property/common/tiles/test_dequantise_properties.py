"""The kernel and its numpy definition give the same bits, for any codebooks, tile size and order of layers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import cags_kernels
from cags_common.coding.packing import U32, PackedCodes, pack_bits
from cags_common.splats import Splats
from cags_common.tiles.attributes import ATTRIBUTE_DIMS
from cags_common.tiles.dequantise import Dequantiser, FreshLayers, positions
from cags_common.tiles.svq import Codebook, CodebookSet

pytestmark = pytest.mark.skipif(not cags_kernels.native_available(), reason="needs the native kernels")
QUICK = settings(max_examples=120, suppress_health_check=[HealthCheck.too_slow])

FORMS = (
    ("scale", "rotation", "alpha", "sh0"),
    ("scale", "rotation_real", "rotation_imag", "opacity", "sh0"),
    ("scale", "rotation", "alpha", "sh0", "sh1"),
    ("scale", "rotation_real", "rotation_imag", "alpha", "sh0", "sh1", "sh2", "sh3"),
)


def table(random: np.random.Generator, bits: int, attribute: str) -> np.ndarray:
    values = random.normal(size=(1 << bits, ATTRIBUTE_DIMS[attribute])).astype(np.float32)
    if attribute == "alpha":
        return random.uniform(-0.01, 1.01, values.shape).astype(np.float32)
    values[random.random(len(values)) < 0.1] = 0.0  # quaternions without a direction, and a scale of exactly one
    return values


def book(random: np.random.Generator, attribute: str, first: tuple[int, ...], second: tuple[int, ...]) -> Codebook:
    bits = [int(b) for stage in (first, second) for b in np.cumsum(stage)]
    tables = tuple(table(random, b, attribute) for b in bits)
    spreads = np.abs(table(random, sum(first), attribute)) if second else None
    return Codebook(attribute, first + second, tables, len(first), spreads)


@st.composite
def codebooks(draw: st.DrawFn) -> CodebookSet:
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    layers = st.lists(st.integers(1, 4), min_size=1, max_size=3).map(tuple)
    return CodebookSet(
        {
            name: book(random, name, draw(layers), draw(layers) if draw(st.booleans()) else ())
            for name in draw(st.sampled_from(FORMS))
        }
    )


def layers_of(given_book: Codebook, codes: U32, first: int, end: int) -> FreshLayers:
    parts = [(given_book.layer(codes, k), given_book.layer_bits[k]) for k in range(first, end)]
    return FreshLayers(first, tuple(PackedCodes(pack_bits(*part), part[1]) for part in parts))


@given(codebooks(), st.integers(1, 1200), st.data())
@QUICK
def test_the_kernel_gives_the_definition_bit_for_bit_however_layers_arrive(
    books: CodebookSet, n: int, data: st.DataObject
) -> None:
    random = np.random.default_rng(n)
    full = [random.integers(0, 1 << sum(b.layer_bits), n).astype(np.uint32) for b in books]
    means = random.normal(size=(n, 3)).astype(np.float32)
    native, plain = Dequantiser(books, native=True), Dequantiser(books, native=False)
    reached, codes = [0] * len(books), None
    for _ in range(data.draw(st.integers(1, 3))):
        ends = [data.draw(st.integers(max(at, 1), len(b.layer_bits))) for at, b in zip(reached, books, strict=True)]
        fresh = [layers_of(b, c, *ab) for b, c, *ab in zip(books, full, reached, ends, strict=True)]
        expected, theirs = plain(means, codes, fresh)
        place = Splats.unwritten(n, expected.sh_degree) if data.draw(st.booleans()) else None
        splats, mine = native(means, codes, fresh, place)
        assert np.array_equal(mine, theirs)
        for (name, a), (_, b) in zip(splats.arrays(), expected.arrays(), strict=True):
            assert a.shape == b.shape, name
            assert np.array_equal(a.view(np.uint32), np.ascontiguousarray(b).view(np.uint32)), name
        reached, codes = ends, mine


@given(st.lists(st.tuples(*[st.integers(0, 2**22 - 1)] * 3), min_size=1, max_size=50), st.floats(-1e6, 1e6), st.data())
@QUICK
def test_positions_agree_bit_for_bit(cells: list[tuple[int, int, int]], origin: float, data: st.DataObject) -> None:
    step = data.draw(st.floats(0, 1e3, width=32))
    grid, corner = np.array(cells, np.uint32), np.array([origin, -origin, 0.1], np.float32)
    assert np.array_equal(positions(grid.astype(np.float32), corner, step), positions(grid, corner, step))
