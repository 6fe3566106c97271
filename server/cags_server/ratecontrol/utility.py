"""Greedy by distortion removed per byte: runs of layers of every tile compete for the budget.

What a picture loses is a sum over its tiles: each tile's share of the picture times the squared error of its splats at
the LoD held. The bundle's measured gains (``lod_gains_db``) say by what factor each layer shrinks that error, so a
decibel on a coarse tile counts for more than one on a fine tile, and quality comes out even where that is best. What a
layer removes is worth as many frames as it will be seen before the media replaces it: detail on splats that change
again in the next frame is worth a thirtieth of the same detail on splats that stay for a second. A base layer is worth
most where nothing stands in for it (a key frame's tile); where it is late, older splats are shown meanwhile.

Motion and updates are valued in the same currency. What lacks its motion stands still, and what lacks an update shows
an old attribute: both errors grow with the time for which that has been so. The last level of motion leaves as much
error as the best looks do, each level before it more. A chunk that begins later may come later as well: the further
ahead, the less it is worth now, so that chunks which begin together are sent one by one while the link has room.

A layer of little gain may stand before one of much: a tile's layers are therefore offered in runs, the steepest first
(the convex hull of what is removed over bytes), which makes the greedy order optimal up to the last run.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from math import log10

from cags_common.motion.chunk import REFINEMENT
from cags_common.tiles.kinds import TileKind
from cags_server.ratecontrol.base import Decision, Observation, TileView
from cags_server.ratecontrol.plan import Plan

HOLE_DB, STALE_DB = 20.0, 6.0
"""How much worse than a base layer is nothing at all, and the splats of the frame before."""

UPDATE_DB = -6.0
"""How much worse than a base layer's error is that of an old attribute: encoders write updates for less than that."""

LEVEL_DB = 20.0 * log10(REFINEMENT)
"""How much more error a level of motion leaves than the next: its unit is so many times the other's."""

AHEAD_FRAMES = 10.0
"""A chunk that begins so many frames later is worth nothing yet."""

FIRST_GAIN_DB, GAIN_DECAY = 2.0, 0.85
"""Gains of enhancement layers where the bundle measured none."""

LEAST_GAIN_DB = 0.005
"""A layer whose measured gain is nothing or less still comes before unused budget."""


KNOWN_HULLS = 4096
"""Tiles whose runs are remembered: from one frame to the next most tiles are held as they were."""


@dataclass(frozen=True, slots=True)
class _Run:
    """LoDs up to ``to_lod`` of a tile, offered together: the distortion that they remove a byte."""

    tile: TileView
    to_lod: int
    slope: float


class UtilityPolicy:
    """Most distortion removed a byte first."""

    def decide(self, observation: Observation) -> Decision:
        """See :class:`~cags_server.ratecontrol.base.RatePolicy`."""
        plan = Plan(observation)
        errors = errors_of(observation)
        runs = _with_their_looks(run for tile in observation.tiles for run in _runs(observation, tile, errors))
        for run in runs:
            while plan.depth(run.tile) < run.to_lod and plan.raise_once(run.tile):
                pass
            if plan.depth(run.tile) == 0 and not plan.lacks(run.tile):
                break  # nothing is worth more a byte than this first level: what is left is saved for it
        return plan.decision()


def _with_their_looks(every: Iterable[_Run]) -> list[_Run]:
    """Runs in the order of what they remove a byte; those of motion after the looks that it moves."""
    runs = list(every)
    first = {(run.tile.frame, run.tile.tile): run.slope for run in reversed(runs)}

    def place(run: _Run) -> tuple[float, int, int, int, int]:
        slope = run.slope if run.tile.after is None else min(run.slope, first.get(run.tile.after, 0.0))
        return -slope, run.tile.kind, run.tile.frame, run.tile.tile, run.to_lod

    return sorted(runs, key=place)


@dataclass(frozen=True, slots=True)
class Errors:
    """Squared errors relative to that of a base layer."""

    lods: tuple[float, ...]
    """Error of a tile held up to each LoD."""
    held: float
    """Mean error, over the picture, of the looks that the client holds."""


def errors_of(observation: Observation) -> Errors:
    """What the bundle's measured gains say of each LoD, and of what the client holds now."""
    lods = _distortions(observation)
    looks = [tile for tile in observation.tiles if tile.kind == TileKind.LOOKS and tile.depth]
    weight = sum(tile.weight for tile in looks)
    return Errors(lods, sum(tile.weight * lods[tile.depth - 1] for tile in looks) / weight if weight else 1.0)


def _distortions(observation: Observation) -> tuple[float, ...]:
    """Squared error of a tile that is held up to each LoD, relative to its base layer's."""
    most = max((tile.max_depth for tile in observation.tiles), default=0)
    most = max(most, len(observation.lod_gains_db) + 1)
    out = [1.0]
    for lod in range(1, most):
        out.append(out[-1] * 10.0 ** (-_gain_db(observation.lod_gains_db, lod) / 10.0))
    return tuple(out)


def _gain_db(measured: tuple[float, ...], lod: int) -> float:
    if len(measured) >= lod:
        return max(measured[lod - 1], LEAST_GAIN_DB)
    return float(FIRST_GAIN_DB * GAIN_DECAY ** (lod - 1))


def _frames_left(tile: TileView) -> float:
    """What is displayed is displayed for one frame at least."""
    return max(tile.frames_left, 1.0)


def absent(tile: TileView, held: float) -> float:
    """Squared error without the tile, relative to that of its base layer, as a mean over the frames that it has left.

    What moves is taken to wander: its squared error grows with the time for which it has been stale, up to a hole's.
    """
    if tile.kind == TileKind.UPDATE:
        return min(held + _ratio(UPDATE_DB) * tile.stale_frames, _ratio(HOLE_DB))
    if tile.kind == TileKind.MOTION:  # a chunk has a long time in which its lack grows
        return min(_ratio(STALE_DB) * (tile.stale_frames + tile.frames_left / 2), _ratio(HOLE_DB))
    wandered = min(_ratio(STALE_DB) * tile.stale_frames, _ratio(HOLE_DB))
    return tile.replaces * wandered + (1.0 - tile.replaces) * _ratio(HOLE_DB)


def _ratio(db: float) -> float:
    return float(10.0 ** (db / 10.0))


def left_by(tile: TileView, distortions: tuple[float, ...]) -> tuple[float, ...]:
    """Squared error of what ``tile`` brings up to each of its LoDs."""
    if tile.kind == TileKind.MOTION:
        finest = tile.max_depth - 1
        return tuple(min(distortions[-1] * _ratio(LEVEL_DB * (finest - level)), 1.0) for level in range(tile.max_depth))
    if tile.kind == TileKind.UPDATE:  # LoDs of attributes that it leaves as they are bring nothing
        out = [1.0]
        for lod in range(1, tile.max_depth):
            out.append(out[-1] * (distortions[lod] / distortions[lod - 1] if tile.lod_bytes[lod] else 1.0))
        return tuple(out)
    return distortions[: tile.max_depth]


def _runs(observation: Observation, tile: TileView, errors: Errors) -> list[_Run]:
    """The tile's missing layers as runs of falling slope."""
    early = max(tile.frame - observation.frame, 0)
    value = tile.weight * _frames_left(tile) * max(1.0 - early / AHEAD_FRAMES, 0.0)
    levels = left_by(tile, errors.lods)
    held = (absent(tile, errors.held), *levels)[tile.depth]
    layered, overhead = observation.layered, observation.message_overhead_bytes
    left = levels[tile.depth :]
    hull = _hull(tile.lod_bytes, tile.depth, held, left, overhead=overhead, layered=layered)
    return [_Run(tile, to_lod, slope * value) for to_lod, slope in hull]


@lru_cache(KNOWN_HULLS)
def _hull(
    sizes: tuple[int, ...], depth: int, held: float, left: tuple[float, ...], *, overhead: int, layered: bool
) -> tuple[tuple[int, float], ...]:
    """(LoDs reached, distortion removed a byte) of the runs from ``depth`` on, for a tile of value 1.

    ``held`` is the distortion at ``depth``, ``left`` that of each LoD from ``depth`` on.
    """
    runs: list[tuple[int, float, float]] = []  # LoDs reached, removed, bytes
    for lod, (before, after) in enumerate(zip((held, *left), left, strict=False), start=depth):
        size = sizes[lod] + (overhead if lod == depth else 0) + 1.0
        if lod and not layered:  # the whole tile goes again, at the better quality
            size = max(size - (sizes[lod - 1] if lod > depth else 0), 1.0)
        to_lod, removed = lod + 1, before - after
        while runs and runs[-1][1] * size <= removed * runs[-1][2]:
            _, more, bytes_before = runs.pop()
            removed, size = removed + more, size + bytes_before
        runs.append((to_lod, removed, size))
    return tuple((to_lod, removed / size) for to_lod, removed, size in runs)
