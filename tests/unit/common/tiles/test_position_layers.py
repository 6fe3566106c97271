"""Positions come in layers: each halves the cell that a position is in, and the last gives what the grid says."""

from __future__ import annotations

import numpy as np
import pytest

from cags_common.errors import BundleError, DecodeError
from cags_common.geometry import F32
from cags_common.tiles.dequantise import Dequantiser
from cags_common.tiles.lod import MAX_POSITION_LAYERS, POSITION, LodLayer, check_order, position_layers
from cags_common.tiles.payloads import (
    PositionGrid,
    decode_base,
    decode_position_layer,
    encode_base,
    encode_layer,
    encode_position_layer,
)
from cags_common.tiles.state import TileState
from cags_common.tiles.updates import UpdateState, encode_update
from support.codec_scenes import books, cloud

BOOKS, SPLATS, BITS = books((4, 2)), 130, 11
ORDER = (
    *(LodLayer(POSITION, layer) for layer in (1, 2)),
    *(LodLayer(name, 1) for name in BOOKS.attributes),
    *(LodLayer(POSITION, layer) for layer in (3, 4)),
)
POSITIONS = [lod for lod, item in enumerate(ORDER, start=1) if item.attribute == POSITION]


def opened(layers: int) -> tuple[TileState, list[bytes], F32, PositionGrid]:
    """A tile with so many ``layers``, its payloads by LoD, and where its splats are."""
    means = cloud(SPLATS).means
    codes = {book.attribute: np.arange(SPLATS, dtype=np.uint32) % 64 for book in BOOKS}
    grid = PositionGrid.over(means, BITS, layers)
    base = {book.attribute: book.layer(codes[book.attribute], 0) for book in BOOKS}
    payloads = [encode_base(np.arange(SPLATS, dtype=np.int32), means, base, grid, BOOKS, id_range=True)]
    for item in ORDER:
        if item.attribute == POSITION:
            payloads.append(encode_position_layer(means, grid, item.layer))
        else:
            payloads.append(encode_layer(BOOKS[item.attribute].layer(codes[item.attribute], 1), 2))
    return TileState(decode_base(payloads[0], BOOKS), Dequantiser(BOOKS), ORDER), payloads, means, grid


def test_each_layer_halves_the_error_and_the_last_gives_the_grid() -> None:
    tile, payloads, means, grid = opened(4)
    cell = grid.step * 16
    assert np.abs(tile.dequantise().means - means).max() <= cell / 2 * 1.001
    base = tile.means
    for lod in POSITIONS:
        assert tile.add_layer(lod, payloads[lod])
        cell /= 2
        assert np.abs(tile.dequantise().means - means).max() <= cell / 2 * 1.001
    np.testing.assert_array_equal(tile.dequantise().means, grid.dequantise(grid.quantise(means)))
    np.testing.assert_array_equal(tile.means, base, "motion is told by the positions of LoD 0, whatever else has come")


def test_whole_positions_are_those_of_a_grid_without_layers() -> None:
    (layered, payloads, *_), (whole, *_) = opened(4), opened(0)
    for lod in POSITIONS:
        layered.add_layer(lod, payloads[lod])
    np.testing.assert_array_equal(layered.dequantise().means, whole.dequantise().means)


def test_layers_come_in_any_order_and_wait_for_those_before() -> None:
    tile, payloads, means, grid = opened(4)
    coarse = tile.dequantise().means
    last, *rest = reversed(POSITIONS)
    assert not tile.add_layer(last, payloads[last]), "it waits"
    np.testing.assert_array_equal(tile.dequantise().means, coarse)
    assert [tile.add_layer(lod, payloads[lod]) for lod in rest] == [False, False, True]
    np.testing.assert_array_equal(tile.dequantise().means, grid.dequantise(grid.quantise(means)))
    assert not tile.add_layer(last, b"damaged"), "nor is it decoded again"


def test_a_tile_with_fewer_layers_than_the_order_lacks_nothing() -> None:
    tile, payloads, means, grid = opened(2)
    assert [len(payloads[lod]) > 0 for lod in POSITIONS] == [True, True, False, False]
    for lod in range(1, len(ORDER) + 1):
        tile.add_layer(lod, payloads[lod])
    assert tile.lod == len(ORDER)
    np.testing.assert_array_equal(tile.dequantise().means, grid.dequantise(grid.quantise(means)))
    with pytest.raises(DecodeError, match="has layer 3 of positions, but its base says 2"):
        tile.add_layer(POSITIONS[2], payloads[1])


def test_a_fork_and_a_reduced_tile_have_positions_of_their_own() -> None:
    tile, payloads, *_ = opened(4)
    tile.add_layer(POSITIONS[0], payloads[POSITIONS[0]])
    one = tile.dequantise().means.copy()
    fork = tile.fork()
    for lod in range(2, len(ORDER) + 1):
        tile.add_layer(lod, payloads[lod])
    np.testing.assert_array_equal(fork.dequantise().means, one)
    assert fork.lod == 1 and tile.lod == len(ORDER)
    reduced = tile.reduced(2)
    assert reduced.lod == 1
    np.testing.assert_array_equal(reduced.dequantise().means, one)
    np.testing.assert_array_equal(tile.reduced(1).dequantise().means, tile.means)


def test_updates_say_nothing_of_positions() -> None:
    ids, mask = np.arange(4, dtype=np.int32), np.ones(4, bool)
    codes = {book.attribute: np.arange(4, dtype=np.uint32) for book in BOOKS}
    payloads = encode_update(ids, dict.fromkeys(BOOKS.attributes, mask), codes, BOOKS, ORDER)
    assert [len(payloads[lod]) for lod in POSITIONS] == [0, 0, 0, 0]
    update = UpdateState(payloads[0], BOOKS, ORDER)
    assert not any(update.add_layer(lod, b"") for lod in POSITIONS)
    for lod in range(1, len(ORDER) + 1):
        update.add_layer(lod, payloads[lod])
    assert update.lod == len(ORDER) and update.reduced(1).lod == 2, "its first levels are of positions"


def test_what_is_wrong_is_named() -> None:
    tile, payloads, *_ = opened(4)
    with pytest.raises(DecodeError, match="layer"):
        tile.add_layer(POSITIONS[0], payloads[POSITIONS[0]][:5])
    for layers, claimed in ((BITS + 1, BITS), (MAX_POSITION_LAYERS + 1, 20)):
        data = bytearray(payloads[0])
        data[1:3] = bytes((1 | layers << 4 & 0xF0, claimed if layers <= 15 else BITS))
        with pytest.raises(DecodeError, match="of them layers"):
            decode_base(bytes(data), BOOKS)
    small = bytearray(payloads[0])
    small[2] = 6  # bits of a grid that the coarse cells are beyond
    with pytest.raises(DecodeError, match="outside its grid of 2 bits"):
        decode_base(bytes(small), BOOKS)
    with pytest.raises(DecodeError, match="outside the allowed range"):
        decode_position_layer(b"", 2**30)


def test_an_order_may_have_any_number_of_layers_of_positions_up_to_a_limit() -> None:
    layers = {"scale": 1}
    for count in (0, 1, MAX_POSITION_LAYERS):
        order = (*(LodLayer(POSITION, layer) for layer in range(1, count + 1)), LodLayer("scale", 1))
        check_order(order, layers)
        assert position_layers(order) == count
    many = [LodLayer(POSITION, layer) for layer in range(1, MAX_POSITION_LAYERS + 2)]
    with pytest.raises(BundleError, match="9 layers of positions; at most 8"):
        check_order((LodLayer("scale", 1), *many), layers)
    with pytest.raises(BundleError, match="is layer 2 of 'position', expected layer 1"):
        check_order((LodLayer(POSITION, 2), LodLayer("scale", 1)), layers)
