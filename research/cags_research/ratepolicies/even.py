"""One level a frame: all visible tiles stand at the same level, the highest to which the budget brings them all.

That is how LTS plays (Sun et al., MMSys 2025): a client asks for one layer of a whole frame.
"""

from __future__ import annotations

from cags_server.ratecontrol.base import Decision, Observation, TileView
from cags_server.ratecontrol.plan import Plan


class EvenPolicy:
    """Raises a frame's tiles together or not at all; base layers, the most visible first, where not even they fit."""

    def decide(self, observation: Observation) -> Decision:
        """See :class:`~cags_server.ratecontrol.base.RatePolicy`."""
        tiles = sorted(observation.tiles, key=lambda t: (t.after is not None, -t.visible, t.kind, t.frame, t.tile))
        for level in range(max((tile.max_depth for tile in tiles), default=0), 1, -1):
            plan = Plan(observation)
            if all(_raised(plan, tile, level) for tile in tiles):
                return plan.decision()
        plan = Plan(observation)
        for tile in tiles:
            _raised(plan, tile, 1)
        return plan.decision()


def _raised(plan: Plan, tile: TileView, level: int) -> bool:
    """Raise ``tile`` to ``level`` or its highest; whether it got there."""
    goal = min(level, tile.max_depth)
    while plan.depth(tile) < goal:
        if not plan.raise_once(tile):
            return False
    return True
