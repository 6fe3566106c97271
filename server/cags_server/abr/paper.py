"""The paper's network adaptation (supplement, "Network Adaptation Strategy"), in its four steps.

1. Visible Gaussians come from the rendered reference (``TileView.visible``).
2. The tiles that own them are the candidates (``Observation.tiles``).
3. Tiles not yet transmitted rise together, level by level, until their average LoD matches that of the tiles already
   sent, or the budget is used up. Where nothing was sent yet there is no average to match: they rise to the top.
4. Tiles already transmitted rise further, the ones with most visible Gaussians first, until the budget is used up.
"""

from __future__ import annotations

from cags_server.abr.base import Decision, Observation, TileView
from cags_server.abr.plan import Plan


class PaperPolicy:
    """Coverage first, then even quality, then the most visible tiles."""

    def decide(self, observation: Observation) -> Decision:
        """See :class:`~cags_server.abr.base.RatePolicy`."""
        by_count = sorted(observation.tiles, key=lambda t: (-t.visible, t.frame, t.tile))
        fresh = [tile for tile in by_count if tile.depth == 0]
        fresh.sort(key=lambda t: -t.visible * t.stale_frames)  # else the same one would come first in every frame
        sent = [tile for tile in by_count if tile.depth > 0]
        plan = Plan(observation)
        if fresh:
            average = sum(t.depth for t in sent) / len(sent) if sent else max(t.max_depth for t in fresh)
            _raise_together(plan, fresh, average)
        if all(plan.depth(tile) > 0 for tile in fresh):  # else the limit is reached: what is left is saved for them
            for tile in sent:
                while plan.raise_once(tile):
                    pass
        return plan.decision()


def _raise_together(plan: Plan, tiles: list[TileView], average: float) -> None:
    """Raise ``tiles`` in rounds until their mean depth reaches ``average``; at least to the base layer."""
    total, goal = 0, max(average, 1.0) * len(tiles)
    rising = list(tiles)
    while rising and total < goal:
        still: list[TileView] = []
        for tile in rising:
            if total >= goal:
                return
            if plan.raise_once(tile):
                total += 1
                still.append(tile)
        rising = still
