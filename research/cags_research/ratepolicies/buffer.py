"""By what is still on its way, without any estimate of bandwidth (after Huang et al., SIGCOMM 2014).

While everything arrives at once, quality rises to the top; the longer the oldest undelivered tile has waited, the fewer
LoDs new tiles get, down to the base layer. Budget and room, which come from an estimate, are not looked at.
"""

from __future__ import annotations

from dataclasses import replace

from cags_server.ratecontrol.base import UNBOUNDED_BYTES, Decision, Observation
from cags_server.ratecontrol.plan import Plan

RESERVOIR_US, CUSHION_US = 60_000, 300_000
"""Waiting time up to which all is well, and from which on only base layers are sent."""


class BufferPolicy:
    """All visible tiles rise together to the depth that the waiting time allows."""

    def decide(self, observation: Observation) -> Decision:
        """See :class:`~cags_server.ratecontrol.base.RatePolicy`; the budget is not kept."""
        # What nothing bounds must not go ahead of the base layers and ends of later frames.
        tiles = tuple(replace(tile, passing=False) for tile in observation.tiles)
        plan = Plan(replace(observation, tiles=tiles, budget_bytes=UNBOUNDED_BYTES, timely_bytes=UNBOUNDED_BYTES))
        share = (CUSHION_US - observation.waiting_us) / (CUSHION_US - RESERVOIR_US)
        # Motion whose looks are to come goes after them, however much of it is seen.
        for tile in sorted(tiles, key=lambda t: (t.after is not None, -t.visible, t.kind, t.frame, t.tile)):
            target = max(1, round(min(max(share, 0.0), 1.0) * tile.max_depth))
            while plan.depth(tile) < target and plan.raise_once(tile):
                pass
        return plan.decision()
