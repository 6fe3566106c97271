"""How much of what a client sees is still to be sent, before its own splats are about as good as they will be."""

from __future__ import annotations

from enum import Enum, auto

from cags_server.ratecontrol.base import Decision, Observation, TileView
from cags_server.ratecontrol.utility import AHEAD_FRAMES, NEAR, errors_of, left_by


def lacking_bytes(observation: Observation) -> int:
    """Bytes missing until every visible tile is about as good as it can be; tiles that begin later count less."""
    errors = errors_of(observation)
    return round(sum(_early(tile, observation.frame) * _bytes(tile, errors.lods) for tile in observation.tiles))


class Supply(Enum):
    """What a client will have of the visible tiles of a frame."""

    BASE_MISSING = auto()
    DETAIL_MISSING = auto()
    COMPLETE = auto()


def supply(observation: Observation, decision: Decision) -> Supply:
    """What the client will have of the tiles that count at the observation's frame after ``decision``."""
    depths = {(upgrade.frame, upgrade.tile): upgrade.to_lod for upgrade in decision.upgrades}
    begun = [tile for tile in observation.tiles if tile.frame <= observation.frame]
    reached = [(depths.get((tile.frame, tile.tile), tile.depth), tile.max_depth) for tile in begun]
    if not all(depth for depth, _ in reached):
        return Supply.BASE_MISSING
    return Supply.COMPLETE if all(depth >= most for depth, most in reached) else Supply.DETAIL_MISSING


def _early(tile: TileView, frame: int) -> float:
    return max(1.0 - max(tile.frame - frame, 0) / AHEAD_FRAMES, 0.0)


def _bytes(tile: TileView, distortions: tuple[float, ...]) -> int:
    levels = left_by(tile, distortions)
    near = next(lod for lod, error in enumerate(levels) if error <= NEAR * levels[-1])
    return sum(tile.lod_bytes[tile.depth : near + 1])
