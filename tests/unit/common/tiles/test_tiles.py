import struct

import numpy as np
import pytest

from cags_common.bundle.codecs import dequantise_tiles
from cags_common.coding.packing import U32
from cags_common.errors import DecodeError
from cags_common.splats import MAX_SPLATS, Splats
from cags_common.tiles.dequantise import Dequantiser, native_available
from cags_common.tiles.lod import LodLayer
from cags_common.tiles.payloads import (
    PositionGrid,
    decode_base,
    decode_base_ids,
    decode_layer,
    encode_base,
    encode_layer,
)
from cags_common.tiles.state import TileState
from cags_common.tiles.svq import CodebookSet
from support.codec_scenes import books, cloud

BOOKS = books((4, 2, 2))
HEADER = struct.Struct("<BBBBIII4f")
FIRST_ID, GRID = 5, 7
"""Fields of a base layer's header: first id or bytes of the id list, then the grid's origin and step."""
ORDER = tuple(LodLayer(name, layer) for layer in (1, 2) for name in BOOKS.attributes)


def full_codes(n: int, seed: int = 1) -> dict[str, U32]:
    random = np.random.default_rng(seed)
    return {book.attribute: random.integers(0, 256, n).astype(np.uint32) for book in BOOKS}


def payload(
    n: int, codes: dict[str, U32], *, id_range: bool = False, bits: int = 14
) -> tuple[bytes, np.ndarray, PositionGrid]:
    means = cloud(n).means
    ids = np.arange(7, 7 + 3 * n, 3, dtype=np.int32) if not id_range else np.arange(7, 7 + n, dtype=np.int32)
    grid = PositionGrid.over(means, bits)
    base = {book.attribute: book.layer(codes[book.attribute], 0) for book in BOOKS}
    return encode_base(ids, means, base, grid, BOOKS, id_range=id_range), ids, grid


@pytest.mark.parametrize("id_range", [False, True])
@pytest.mark.parametrize("n", [0, 1, 2, 300])
def test_a_base_layer_comes_back(n: int, id_range: bool) -> None:
    codes = full_codes(n)
    data, ids, grid = payload(n, codes, id_range=id_range)
    tile = decode_base(data, BOOKS)
    assert np.array_equal(tile.ids, ids)
    assert np.array_equal(decode_base_ids(data), ids)
    means = cloud(n).means
    assert np.array_equal(tile.means, grid.dequantise(grid.quantise(means)))
    assert np.abs(tile.means - means).max(initial=0) <= grid.step * 0.5001 + 1e-6
    for book in BOOKS:
        assert np.array_equal(tile.codes[book.attribute], book.layer(codes[book.attribute], 0))


def test_the_same_tile_gives_the_same_bytes() -> None:
    assert payload(50, full_codes(50))[0] == payload(50, full_codes(50))[0]


def test_duplicate_positions_and_a_range_of_a_million_keep_their_order() -> None:
    means = np.zeros((6, 3), np.float32)
    means[2:4] = 1e6
    means[4] = (5e5, -2.0, 1.0)
    grid = PositionGrid.over(means, 22)
    codes = {name: np.arange(6, dtype=np.uint32) for name in BOOKS.attributes}
    tile = decode_base(encode_base(np.arange(6, dtype=np.int32), means, codes, grid, BOOKS, id_range=True), BOOKS)
    assert np.abs(tile.means - means).max() <= grid.step
    assert np.array_equal(tile.codes["scale"], np.arange(6))


def state(n: int, codes: dict[str, U32]) -> tuple[TileState, list[bytes]]:
    data, _, _ = payload(n, codes)
    layers = [encode_layer(BOOKS[item.attribute].layer(codes[item.attribute], item.layer), 2) for item in ORDER]
    return TileState(decode_base(data, BOOKS), Dequantiser(BOOKS), ORDER), layers


def test_layers_may_come_in_any_order() -> None:
    codes = full_codes(40)
    ordered, layers = state(40, codes)
    mixed, _ = state(40, codes)
    for lod in range(1, len(ORDER) + 1):
        assert ordered.add_layer(lod, layers[lod - 1])
    for lod in np.random.default_rng(3).permutation(len(ORDER)) + 1:
        mixed.add_layer(int(lod), layers[lod - 1])
    assert ordered.lod == mixed.lod == len(ORDER)
    for (name, a), (_, b) in zip(ordered.dequantise().arrays(), mixed.dequantise().arrays(), strict=True):
        assert np.array_equal(a, b), name
    assert np.array_equal(ordered.dequantise().log_scales, BOOKS["scale"].tables[2][codes["scale"]])


def test_a_gap_holds_an_attribute_back_and_a_late_layer_raises_it_in_place() -> None:
    codes = full_codes(40)
    tile, layers = state(40, codes)
    second = ORDER.index(LodLayer("sh0", 2)) + 1
    first = ORDER.index(LodLayer("sh0", 1)) + 1
    assert not tile.add_layer(second, layers[second - 1])
    assert tile.depth("sh0") == 0
    assert tile.add_layer(first, layers[first - 1])
    assert tile.depth("sh0") == 2
    assert tile.lod == 0, "LoD 1 is scale's layer, which is missing"
    assert np.array_equal(tile.dequantise().sh0, BOOKS["sh0"].tables[2][codes["sh0"]])


def test_a_layer_that_is_there_already_changes_nothing() -> None:
    tile, layers = state(10, full_codes(10))
    assert tile.add_layer(1, layers[0])
    assert not tile.add_layer(1, layers[0])
    assert not tile.add_layer(1, b"damaged"), "nor is it decoded again"


def test_decoded_rotations_are_unit_with_a_positive_real_part() -> None:
    tile, _ = state(40, full_codes(40))
    quats = tile.dequantise().quats
    assert np.allclose(np.linalg.norm(quats, axis=1), 1, atol=1e-6)
    assert (quats[:, 0] >= 0).all()


BOTH = pytest.mark.parametrize(
    "native",
    [False, pytest.param(True, marks=pytest.mark.skipif(not native_available(), reason="needs the native kernels"))],
)


def opened(n: int, *, native: bool) -> TileState:
    return TileState(decode_base(payload(n, full_codes(n))[0], BOOKS), Dequantiser(BOOKS, native=native), ORDER)


@BOTH
def test_tiles_are_written_side_by_side_as_they_are_one_by_one(native: bool) -> None:
    sizes = (40, 0, 1, 600)
    merged = dequantise_tiles([opened(n, native=native) for n in sizes], 0)
    alone = Splats.concatenate([opened(n, native=native).dequantise() for n in sizes])
    for (name, a), (_, b) in zip(merged.arrays(), alone.arrays(), strict=True):
        assert np.array_equal(a, b), name
    assert len(dequantise_tiles([], 2)) == 0


@BOTH
def test_a_place_of_another_sh_degree_is_refused(native: bool) -> None:
    with pytest.raises(DecodeError, match="SH degree 0, their place 1"):
        dequantise_tiles([opened(5, native=native)], 1)


def test_wrong_use_is_named() -> None:
    tile, layers = state(10, full_codes(10))
    with pytest.raises(DecodeError, match="LoD 0 is outside 1 to"):
        tile.add_layer(0, layers[0])
    with pytest.raises(DecodeError, match=r"holds|take|unpacks"):
        tile.add_layer(1, encode_layer(np.zeros(11, np.uint32), 8))
    data, _, _ = payload(10, full_codes(10))
    with pytest.raises(DecodeError, match="has 5 attributes, the codebooks 1"):
        decode_base(data, CodebookSet({"scale": BOOKS["scale"]}))
    with pytest.raises(DecodeError, match=r"of bits|beyond|cut short|few|Draco"):
        decode_base(data[: len(data) // 2], BOOKS)


def test_a_claim_beyond_the_bounds_is_refused_before_anything_is_allocated() -> None:
    data = bytearray(payload(10, full_codes(10))[0])
    data[4:8] = (2**31).to_bytes(4, "little")
    with pytest.raises(DecodeError, match="beyond bounds"):
        decode_base(bytes(data), BOOKS)
    with pytest.raises(DecodeError, match="outside the allowed range"):
        decode_layer(b"", 2**30, 2)


def changed(data: bytes, field: int, value: int | float) -> bytes:
    """A base layer with one field of its header replaced."""
    fields = list(HEADER.unpack_from(data))
    fields[field] = value
    return HEADER.pack(*fields) + data[HEADER.size :]


def test_ids_that_reach_beyond_the_largest_scene_are_refused() -> None:
    data = payload(10, full_codes(10), id_range=True)[0]
    last = changed(data, FIRST_ID, MAX_SPLATS - 10)
    assert decode_base(last, BOOKS).ids.tolist() == list(range(MAX_SPLATS - 10, MAX_SPLATS))
    with pytest.raises(DecodeError, match="first id"):
        decode_base(changed(data, FIRST_ID, MAX_SPLATS - 9), BOOKS)


def test_as_many_ids_as_splats() -> None:
    (ten, *_), (nine, *_) = payload(10, full_codes(10)), payload(9, full_codes(9))
    ids, other = (data[HEADER.size : HEADER.size + HEADER.unpack_from(data)[FIRST_ID]] for data in (ten, nine))
    swapped = changed(ten, FIRST_ID, len(other))[: HEADER.size] + other + ten[HEADER.size + len(ids) :]
    with pytest.raises(DecodeError, match="claims 9 ids for 10 splats"):
        decode_base(swapped, BOOKS)


@pytest.mark.parametrize(
    ("field", "value"), [(GRID, 9e30), (GRID + 2, -9e30), (GRID + 3, 1e30), (GRID + 3, -1.0), (GRID, float("nan"))]
)
def test_a_grid_that_float32_cannot_hold_is_refused(field: int, value: float) -> None:
    with pytest.raises(DecodeError, match="position grid"):
        decode_base(changed(payload(10, full_codes(10))[0], field, value), BOOKS)
