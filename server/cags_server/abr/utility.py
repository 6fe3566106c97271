"""Greedy by gain per byte: every next layer of every tile competes for the budget.

The gain of a layer is its measured quality gain (the bundle's ``lod_gains_db``), times the share of the picture that
the tile's visible splats make up, times the frames for which they will be seen before the media replaces them: detail
on splats that change again in the next frame is worth a thirtieth of detail on splats that stay for a second. A base
layer is worth most where nothing stands in for it (a key frame's tile); where it is late, older splats are shown
meanwhile.
"""

from __future__ import annotations

import heapq

from cags_server.abr.base import Decision, Observation, TileView
from cags_server.abr.plan import Plan

BASE_GAIN_DB, CHANGED_GAIN_DB = 20.0, 6.0
"""Of a base layer: where a hole would gape, and where the splats of an earlier frame stand in."""

FIRST_GAIN_DB, GAIN_DECAY = 2.0, 0.85
"""Gains of enhancement layers where the bundle measured none."""

LEAST_GAIN_DB = 0.005
"""A layer whose measured gain is nothing or less still comes before unused budget."""


class UtilityPolicy:
    """Most decibels a byte first."""

    def decide(self, observation: Observation) -> Decision:
        """See :class:`~cags_server.abr.base.RatePolicy`."""
        plan = Plan(observation)
        heap = [
            (-density, t.frame, t.tile, t) for t in observation.tiles if (density := _density(observation, t, t.depth))
        ]
        heapq.heapify(heap)
        while heap:
            _, frame, number, tile = heapq.heappop(heap)
            if not plan.raise_once(tile):
                if plan.depth(tile) == 0:
                    break  # nothing is worth more a byte than this base layer: what is left is saved for it
                continue  # too large for what is left, or complete; smaller ones may still fit
            density = _density(observation, tile, plan.depth(tile))
            if density:
                heapq.heappush(heap, (-density, frame, number, tile))
        return plan.decision()


def _density(observation: Observation, tile: TileView, lod: int) -> float:
    """Decibel-frames a byte of LoD ``lod`` of a tile; 0 where it has no such layer."""
    if lod >= tile.max_depth:
        return 0.0
    gain = _gain_db(observation, tile, lod) * tile.weight * tile.frames_left
    fresh = observation.message_overhead_bytes if lod == tile.depth else 0
    return gain / (tile.lod_bytes[lod] + fresh + 1)


def _gain_db(observation: Observation, tile: TileView, lod: int) -> float:
    if lod == 0:
        return CHANGED_GAIN_DB if tile.replaces else BASE_GAIN_DB
    if len(observation.lod_gains_db) >= lod:
        return max(observation.lod_gains_db[lod - 1], LEAST_GAIN_DB)
    return float(FIRST_GAIN_DB * GAIN_DECAY ** (lod - 1))
