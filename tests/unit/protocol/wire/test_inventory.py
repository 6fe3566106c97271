import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_common.errors import ProtocolError
from cags_common.tiles.inventory import InventoryEntry
from cags_common.tiles.lod import MAX_LODS
from cags_protocol.wire.encoding import decode, encode
from cags_protocol.wire.inventory import MAX_INVENTORY_TILES, pack_inventory, unpack_inventory
from cags_protocol.wire.limits import MAX_CLIENT_MESSAGE_BYTES
from support.wire_pair import hello

TILES = st.builds(InventoryEntry, st.integers(0, 2**31 - 1), st.integers(0, 2**16 - 1), st.integers(1, MAX_LODS))


@given(st.lists(TILES, max_size=40))
def test_an_inventory_survives_the_wire(tiles):
    message, _ = decode(encode(hello(resume="s", inventory=pack_inventory(tiles))))
    key = lambda t: (t.frame, t.tile, t.lods)  # noqa: E731
    assert sorted(unpack_inventory(message.inventory), key=key) == sorted(tiles, key=key)


def test_the_newest_tiles_are_kept_and_empty_ones_left_out():
    packed = pack_inventory(InventoryEntry(i, 0, i % 2) for i in range(4 * MAX_INVENTORY_TILES))
    tiles = unpack_inventory(packed)
    assert len(tiles) == MAX_INVENTORY_TILES
    assert tiles[0].frame == 4 * MAX_INVENTORY_TILES - 1
    assert all(t.lods for t in tiles)
    assert len(encode(hello(inventory=packed))) < MAX_CLIENT_MESSAGE_BYTES


@pytest.mark.parametrize(
    "data",
    [b"123", bytes(7), b"\xff" * 7, bytes(6) + bytes([MAX_LODS + 1]), bytes(7 * (MAX_INVENTORY_TILES + 1))],
    ids=["cut", "none", "wild", "deep", "long"],
)
def test_what_is_no_inventory_is_refused(data):
    with pytest.raises(ProtocolError, match="inventory"):
        unpack_inventory(data)
