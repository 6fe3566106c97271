"""What a client still holds when it comes back: the payload of a Hello that resumes.

Seven bytes a tile: frame (uint32), tile (uint16), LoDs from 0 held (uint8), little endian, in any order.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable

from cags_common.errors import ProtocolError
from cags_common.tiles.inventory import InventoryEntry
from cags_common.tiles.lod import MAX_LODS

_TILE = struct.Struct("<IHB")

MAX_INVENTORY_TILES = 16_384
"""Tiles in one inventory; together with the rest of a Hello they stay below the longest message of a client."""


def pack_inventory(tiles: Iterable[InventoryEntry]) -> bytes:
    """The newest :data:`MAX_INVENTORY_TILES` of what is held; tiles of which nothing is held are left out."""
    held = sorted((t for t in tiles if t.lods), key=lambda t: (-t.frame, t.tile))
    return b"".join(_TILE.pack(t.frame, t.tile, t.lods) for t in held[:MAX_INVENTORY_TILES])


def unpack_inventory(data: bytes) -> tuple[InventoryEntry, ...]:
    """The tiles of an inventory. Raises :class:`ProtocolError` for what is none."""
    count, rest = divmod(len(data), _TILE.size)
    if rest or count > MAX_INVENTORY_TILES:
        raise ProtocolError(
            f"inventory has {len(data)} bytes; at most {MAX_INVENTORY_TILES} tiles of {_TILE.size} each"
        )
    tiles = tuple(InventoryEntry(*fields) for fields in _TILE.iter_unpack(data))
    for t in tiles:
        if t.frame > 2**31 - 1 or not 1 <= t.lods <= MAX_LODS:
            raise ProtocolError(
                f"inventory: frame {t.frame}, tile {t.tile}, {t.lods} LoDs is not a tile that can be held"
            )
    return tiles
