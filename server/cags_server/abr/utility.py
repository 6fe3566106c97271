"""Greedy by distortion removed per byte: runs of layers of every tile compete for the budget.

What a picture loses is a sum over its tiles: each tile's share of the picture times the squared error of its splats at
the LoD held. The bundle's measured gains (``lod_gains_db``) say by what factor each layer shrinks that error, so a
decibel on a coarse tile counts for more than one on a fine tile, and quality comes out even where that is best. What a
layer removes is worth as many frames as it will be seen before the media replaces it: detail on splats that change
again in the next frame is worth a thirtieth of the same detail on splats that stay for a second. A base layer is worth
most where nothing stands in for it (a key frame's tile); where it is late, older splats are shown meanwhile.

A layer of little gain may stand before one of much: a tile's layers are therefore offered in runs, the steepest first
(the convex hull of what is removed over bytes), which makes the greedy order optimal up to the last run.
"""

from __future__ import annotations

from dataclasses import dataclass

from cags_server.abr.base import Decision, Observation, TileView
from cags_server.abr.plan import Plan

HOLE_DB, STALE_DB = 20.0, 6.0
"""How much worse than a base layer is nothing at all, and the splats of an earlier frame."""

FIRST_GAIN_DB, GAIN_DECAY = 2.0, 0.85
"""Gains of enhancement layers where the bundle measured none."""

LEAST_GAIN_DB = 0.005
"""A layer whose measured gain is nothing or less still comes before unused budget."""


@dataclass(slots=True)
class _Run:
    """LoDs up to ``to_lod`` of a tile, offered together: what they remove, and their bytes."""

    tile: TileView
    to_lod: int
    removed: float
    size: float

    @property
    def slope(self) -> float:
        """Distortion removed a byte."""
        return self.removed / self.size


class UtilityPolicy:
    """Most distortion removed a byte first."""

    def decide(self, observation: Observation) -> Decision:
        """See :class:`~cags_server.abr.base.RatePolicy`."""
        plan = Plan(observation)
        shrunk = _distortions(observation)
        runs = [run for tile in observation.tiles for run in _runs(observation, tile, shrunk)]
        runs.sort(key=lambda run: (-run.slope, run.tile.frame, run.tile.tile, run.to_lod))
        for run in runs:
            while plan.depth(run.tile) < run.to_lod and plan.raise_once(run.tile):
                pass
            if plan.depth(run.tile) == 0:
                break  # nothing is worth more a byte than this base layer: what is left is saved for it
        return plan.decision()


def _distortions(observation: Observation) -> list[float]:
    """Squared error of a tile that is held up to each LoD, relative to its base layer's."""
    most = max((tile.max_depth for tile in observation.tiles), default=0)
    out = [1.0]
    for lod in range(1, most):
        out.append(out[-1] * 10.0 ** (-_gain_db(observation.lod_gains_db, lod) / 10.0))
    return out


def _gain_db(measured: tuple[float, ...], lod: int) -> float:
    if len(measured) >= lod:
        return max(measured[lod - 1], LEAST_GAIN_DB)
    return float(FIRST_GAIN_DB * GAIN_DECAY ** (lod - 1))


def _runs(observation: Observation, tile: TileView, distortions: list[float]) -> list[_Run]:
    """The tile's missing layers as runs of falling slope."""
    value = tile.weight * tile.frames_left
    runs: list[_Run] = []
    for lod in range(tile.depth, tile.max_depth):
        before = distortions[lod - 1] if lod else 10.0 ** ((STALE_DB if tile.replaces else HOLE_DB) / 10.0)
        overhead = observation.message_overhead_bytes if lod == tile.depth else 0
        size = tile.lod_bytes[lod] + overhead + 1.0
        if lod and not observation.layered:  # the whole tile goes again, at the better quality
            size = max(size - (tile.lod_bytes[lod - 1] if lod > tile.depth else 0), 1.0)
        run = _Run(tile, lod + 1, (before - distortions[lod]) * value, size)
        while runs and runs[-1].slope <= run.slope:
            last = runs.pop()
            run = _Run(tile, run.to_lod, last.removed + run.removed, last.size + run.size)
        runs.append(run)
    return runs
