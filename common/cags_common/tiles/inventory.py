"""What a client says that it holds of a tile."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class InventoryEntry:
    """A client holds LoDs 0 .. ``lods`` - 1 of a tile of a media frame; ``lods`` = 0: nothing of it."""

    frame: int
    tile: int
    lods: int
