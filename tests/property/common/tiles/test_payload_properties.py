"""Payloads come back; damaged ones raise the one error, and never anything else."""

from __future__ import annotations

import gzip
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cags_common.coding.packing import decode_ids, encode_ids, gzip_bytes, pack_bits, packed_bytes, unpack_bits
from cags_common.errors import DecodeError
from cags_common.tiles.lod import MAX_POSITION_LAYERS
from cags_common.tiles.payloads import (
    PositionGrid,
    decode_base,
    decode_base_ids,
    decode_layer,
    decode_position_layer,
    encode_base,
    encode_layer,
    encode_position_layer,
)
from cags_common.tiles.svq import CodebookSet
from support.codec_scenes import books, cloud
from support.mutation import mutate

BOOKS = books((4, 2))
QUICK = settings(max_examples=150, suppress_health_check=[HealthCheck.too_slow])


def some_payload() -> bytes:
    means = cloud(60).means
    codes = {name: np.arange(60, dtype=np.uint32) % 16 for name in BOOKS.attributes}
    return encode_base(np.arange(0, 120, 2, dtype=np.int32), means, codes, GRID, BOOKS, id_range=False)


GRID = PositionGrid.over(cloud(60).means, 12, 3)
PAYLOAD = some_payload()
POSITION_LAYER = encode_position_layer(cloud(60).means, GRID, 2)
LAYER = encode_layer(np.arange(60, dtype=np.uint32) % 4, 2)


@given(st.integers(1, 32), st.data())
@QUICK
def test_packed_codes_come_back(bits: int, data: st.DataObject) -> None:
    codes = np.array(data.draw(st.lists(st.integers(0, 2**bits - 1), max_size=40)), np.uint32)
    packed = pack_bits(codes, bits)
    assert len(packed) == packed_bytes(len(codes), bits)
    assert np.array_equal(unpack_bits(packed, len(codes), bits), codes)


@given(st.sets(st.integers(0, 2**24), max_size=60))
@QUICK
def test_id_lists_come_back(ids: set[int]) -> None:
    given_ids = np.array(sorted(ids), np.int32)
    assert np.array_equal(decode_ids(encode_ids(given_ids)), given_ids)


@given(st.lists(st.tuples(*[st.floats(-1e6, 1e6, width=32)] * 3), min_size=1, max_size=30), st.integers(1, 22))
@QUICK
def test_positions_come_back_within_half_a_step(points: list[tuple[float, float, float]], bits: int) -> None:
    means = np.array(points, np.float32)
    grid = PositionGrid.over(means, bits)
    codes = {name: np.zeros(len(means), np.uint32) for name in BOOKS.attributes}
    tile = decode_base(
        encode_base(np.arange(len(means), dtype=np.int32), means, codes, grid, BOOKS, id_range=True), BOOKS
    )
    rounding = np.spacing(np.abs(means).max()) * 2
    assert np.abs(tile.means.astype(np.float64) - means).max() <= grid.step * 0.5000001 + rounding


@given(
    st.lists(st.tuples(*[st.floats(-1e6, 1e6, width=32)] * 3), min_size=1, max_size=30),
    st.integers(1, 22),
    st.integers(0, MAX_POSITION_LAYERS),
)
@QUICK
def test_every_layer_halves_the_cell_that_a_position_is_in(
    points: list[tuple[float, float, float]], bits: int, layers: int
) -> None:
    means, layers = np.array(points, np.float32), min(layers, bits)
    grid = PositionGrid.over(means, bits, layers)
    codes = {name: np.zeros(len(means), np.uint32) for name in BOOKS.attributes}
    ids = np.arange(len(means), dtype=np.int32)
    tile = decode_base(encode_base(ids, means, codes, grid, BOOKS, id_range=True), BOOKS)
    rounding = np.spacing(np.abs(means).max()) * 2
    come: list[np.ndarray] = []
    for depth in range(layers + 1):
        if depth:
            come.append(decode_position_layer(encode_position_layer(means, grid, depth), len(means)))
        cell = grid.step * 2 ** (layers - depth)
        shown = tile.refined(come)
        assert np.abs(shown.astype(np.float64) - means).max() <= cell * 0.5000001 + grid.step * 0.5 + rounding
    assert np.array_equal(shown, grid.dequantise(grid.quantise(means)))


MAGIC = BOOKS.to_bytes()[:8]
PARSERS: dict[str, tuple[Callable[[bytes], object], bytes]] = {
    "base": (lambda bad: decode_base(bad, BOOKS), PAYLOAD),
    "base ids": (decode_base_ids, PAYLOAD),
    "layer of positions": (lambda bad: decode_position_layer(bad, 60), POSITION_LAYER),
    "layer": (lambda bad: decode_layer(bad, 60, 2), LAYER),
    "ids": (decode_ids, encode_ids(np.arange(0, 900, 7, dtype=np.int32))),
    "codebooks": (CodebookSet.from_bytes, BOOKS.to_bytes()),
    "codebooks inside": (
        lambda body: CodebookSet.from_bytes(MAGIC + gzip_bytes(body)),
        gzip.decompress(BOOKS.to_bytes()[8:]),
    ),
}


def fuzz(name: str, cases: int, seed: int) -> int:
    """How many of so many damaged payloads are read all the same; the others raise one line of DecodeError."""
    decode, whole = PARSERS[name]
    read = 0
    for case in range(cases):
        try:
            decode(mutate(whole, np.random.default_rng((seed, case))))
        except DecodeError as error:
            assert "\n" not in str(error)
            continue
        read += 1
    return read


@pytest.mark.parametrize("name", PARSERS)
def test_damaged_payloads(name: str) -> None:
    assert fuzz(name, 2_000, seed=1) < 2_000


@pytest.mark.nightly
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", PARSERS)
def test_damaged_payloads_at_length(name: str) -> None:
    fuzz(name, 100_000, seed=2)
