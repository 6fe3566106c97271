"""What a tile brings: whole splats, the motion of a tile's splats, or single attributes of splats that are there."""

from __future__ import annotations

from enum import IntEnum


class TileKind(IntEnum):
    """Kinds of tiles, as bundles number them."""

    LOOKS = 0
    """New splats: positions, rotations and all other attributes, in levels."""
    MOTION = 1
    """A chunk of motion of the splats of one tile of looks (:mod:`cags_common.motion.chunk`)."""
    UPDATE = 2
    """Attributes that changed, of splats that are there (:mod:`cags_common.tiles.updates`)."""
