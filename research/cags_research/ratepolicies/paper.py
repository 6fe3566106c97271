"""The paper's network adaptation (supplement, "Network Adaptation Strategy"), in its four steps.

1. Visible Gaussians come from the rendered reference (``TileView.visible``).
2. The tiles that own them are the candidates (``Observation.tiles``).
3. Tiles not yet transmitted rise together, level by level, until their average LoD matches that of the tiles already
   sent, or the budget is used up. Where nothing was sent yet there is no average to match: they rise to the top.
4. Tiles already transmitted rise further, the ones with most visible Gaussians first, until the budget is used up.

The paper knows tiles of whole splats alone. Motion and updates count as further tiles here: their first levels are
transmitted with those of looks, motion after the looks that it moves, and the levels above the first are step 4's.
"""

from __future__ import annotations

from cags_common.tiles.kinds import TileKind
from cags_server.ratecontrol.base import Decision, Observation, TileView
from cags_server.ratecontrol.plan import Plan


class PaperPolicy:
    """Coverage first, then even quality, then the most visible tiles."""

    def decide(self, observation: Observation) -> Decision:
        """See :class:`~cags_server.ratecontrol.base.RatePolicy`."""
        by_count = sorted(observation.tiles, key=lambda t: (-t.visible, t.kind, t.frame, t.tile))
        fresh = [tile for tile in by_count if tile.depth == 0]
        # Without the age the same one would come first in every frame.
        fresh.sort(key=lambda t: (t.after is not None, -t.visible * t.stale_frames))
        sent = [tile for tile in by_count if tile.depth > 0]
        looks = [tile for tile in fresh if tile.kind == TileKind.LOOKS]
        others = [tile for tile in fresh if tile.kind != TileKind.LOOKS]
        plan = Plan(observation)
        _raise_together(plan, looks, 1.0)
        _raise_together(plan, others, 1.0)
        if looks:
            _raise_together(plan, looks, _average(sent, looks))
        if all(plan.depth(t) > 0 for t in fresh if t.frame <= observation.frame):
            for tile in [*sent, *others]:
                while plan.raise_once(tile):
                    pass
        return plan.decision()  # where the limit is reached what is left is saved for new tiles


def _average(sent: list[TileView], fresh: list[TileView]) -> float:
    """LoDs that looks which were sent have on average; where there are none, the most that ``fresh`` has."""
    depths = [tile.depth for tile in sent if tile.kind == TileKind.LOOKS]
    return sum(depths) / len(depths) if depths else max(tile.max_depth for tile in fresh)


def _raise_together(plan: Plan, tiles: list[TileView], average: float) -> None:
    """Raise ``tiles`` in rounds until their mean depth reaches ``average``; at least to the base layer."""
    total, goal = sum(plan.depth(tile) for tile in tiles), max(average, 1.0) * len(tiles)
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
