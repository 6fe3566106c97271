"""Greedy choice by distortion removed per byte: runs of layers of all tiles compete for the budget.

The distortion of a picture is a sum over its tiles: each tile's share of the picture times the squared error of its
splats at the held LoD. The bundle's measured gains (``lod_gains_db``) give the factor by which each layer reduces that
error, so a decibel on a coarse tile counts for more than one on a fine tile. A layer's value grows with the number of
frames for which it will be seen before the media replaces it: detail on splats that change in the next frame is worth a
thirtieth of the same detail on splats that stay for a second. A base layer is worth most if the client holds no older
splats in its place, as in a key frame.

Motion and updates have the same unit of value. Splats without their motion stand still, which is the worse the longer
it lasts; how fast is measured by the encoder (``still_psnr_db``), since clips differ by a factor of ten thousand. That
is an error of the whole picture; it is divided among tiles by their bytes of motion. Splats without their updates show
old attributes, which gets worse in the same way (``outdated_psnr_db``): a single missing update is hardly seen, ten in
a row ruin some pictures. The last level of motion that says anything leaves as much error as the best looks
do, each level before it more. A chunk that begins later is worth less now, so chunks that begin together are sent one
by one while the link has room.

A layer of small gain may precede one of large gain. A tile's layers are therefore offered in runs along the convex hull
of removed distortion over bytes, steepest first, which makes the greedy order optimal up to the last run.

The first layers of a tile may be worse than what is shown without it: they go with as many more as it takes to be
better, or not at all. An update arrives about as good as what is around it; in two steps its splats would be seen to
change twice.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate
from math import log10

from cags_common.motion.chunk import REFINEMENT
from cags_common.tiles.kinds import TileKind
from cags_server.ratecontrol.base import Decision, Observation, TileView
from cags_server.ratecontrol.plan import Plan

HOLE_DB, STALE_DB = 20.0, 6.0
"""Error of a missing tile, and of the previous frame's splats where that was not measured, relative to a base layer."""

OUTDATED = 1.0
"""Error of an attribute that is out of date for a frame, relative to a base layer's, where it was not measured."""

LEVEL_DB = 20.0 * log10(REFINEMENT)
"""Error of a level of motion relative to the next, by the ratio of their units."""

AHEAD_FRAMES = 10.0
"""Number of frames before its beginning at which a chunk has no value yet."""

FIRST_GAIN_DB, GAIN_DECAY = 2.0, 0.85
"""Gain of enhancement layers in bundles without measured gains."""

LEAST_GAIN_DB = 0.005
"""Smallest gain of a layer, so that layers without measured gain still use free budget."""


NEAR = 2.0
"""Looks are about as good as others if they leave at most so many times the squared error."""

KNOWN_HULLS = 512
"""Number of tiles whose runs are cached (1.5 kB each); most do not change between frames. Motion and updates that are
lacked do: they weigh more in every frame.
"""


@dataclass(frozen=True, slots=True)
class _Run:
    """LoDs up to ``to_lod`` of a tile, offered together, and the distortion that they remove per byte."""

    tile: TileView
    to_lod: int
    slope: float
    together: int = 0
    """The first so many LoDs are planned together or not at all; 0 where each may go alone."""


class UtilityPolicy:
    """Chooses the layers with the most distortion removed per byte first."""

    def decide(self, observation: Observation) -> Decision:
        """See :class:`~cags_server.ratecontrol.base.RatePolicy`."""
        plan = Plan(observation)
        errors = errors_of(observation)
        runs = _with_their_looks(run for tile in observation.tiles for run in _runs(observation, tile, errors))
        for run in runs:
            if plan.depth(run.tile) < run.together:
                plan.raise_together(run.tile, run.together)
            while run.together <= plan.depth(run.tile) < run.to_lod and plan.raise_once(run.tile):
                pass
            if plan.depth(run.tile) == 0 and not plan.lacks(run.tile):
                break  # no level has more value per byte than this one, so the rest of the budget is saved for it
        return plan.decision()


def _with_their_looks(every: Iterable[_Run]) -> list[_Run]:
    """Runs by falling distortion removed per byte, with motion after the looks that it moves."""
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
    """Error of a tile at each held LoD."""
    held: float
    """Mean error of the held looks over the picture."""
    still: tuple[tuple[float, float], ...] = ()
    """See :attr:`~cags_server.ratecontrol.base.Observation.still_errors`."""
    outdated: tuple[tuple[float, float], ...] = ()
    """See :attr:`~cags_server.ratecontrol.base.Observation.outdated_errors`."""
    motion_density: float = 0.0
    """See :attr:`~cags_server.ratecontrol.base.Observation.motion_density`."""


def errors_of(observation: Observation) -> Errors:
    """Errors at each LoD from the bundle's measured gains, and of the client's picture."""
    lods = _distortions(observation)
    looks = [tile for tile in observation.tiles if tile.kind == TileKind.LOOKS and tile.depth]
    weight = sum(tile.weight for tile in looks)
    held = sum(tile.weight * lods[tile.depth - 1] for tile in looks) / weight if weight else 1.0
    return Errors(lods, held, observation.still_errors, observation.outdated_errors, observation.motion_density)


def _distortions(observation: Observation) -> tuple[float, ...]:
    """Squared error of a tile at each held LoD, relative to its base layer's."""
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
    """Lifetime of what the tile brings, one frame at least."""
    return max(tile.frames_left, 1.0)


def absent(tile: TileView, errors: Errors) -> float:
    """Squared error without the tile, relative to that of its base layer, as a mean over its remaining frames."""
    if tile.kind == TileKind.UPDATE:
        frames = tile.stale_frames + (_frames_left(tile) - 1) / 2
        return min(errors.held + grown(frames, errors.outdated or ((1.0, OUTDATED),)), _ratio(HOLE_DB))
    if tile.kind == TileKind.MOTION:  # the error of a missing chunk grows for a long time
        moving = _share_of_motion(tile, errors.motion_density)
        return min(moving * _stood_still(tile.stale_frames + tile.frames_left / 2, errors), _ratio(HOLE_DB))
    return tile.replaces * _stood_still(tile.stale_frames, errors) + (1.0 - tile.replaces) * _ratio(HOLE_DB)


def _share_of_motion(tile: TileView, density: float) -> float:
    """The motion in ``tile`` relative to its share of the picture, estimated from its bytes of motion."""
    return tile.motion_bytes / (tile.weight * density) if tile.motion_bytes and tile.weight * density else 1.0


def _stood_still(frames: float, errors: Errors) -> float:
    return grown(frames, errors.still or ((1.0, _ratio(STALE_DB)),))


def grown(frames: float, measured: tuple[tuple[float, float], ...]) -> float:
    """Squared error of splats that have been out of date for so many ``frames``, relative to a base layer's: at most
    that of a hole.

    Between the ``measured`` points and beyond them it follows lines. From a single one the change is taken for a random
    walk, whose squared error grows in proportion to time.
    """
    points = ((0.0, 0.0), *measured)
    following = next((at for at in range(1, len(points)) if frames <= points[at][0]), len(points) - 1)
    (first, low), (last, high) = points[following - 1 : following + 1]
    slope = (high - low) / (last - first)
    error = high + max(slope, 0.0) * (frames - last) if frames > last else low + slope * (frames - first)
    return min(error, _ratio(HOLE_DB))


def _ratio(db: float) -> float:
    return float(10.0 ** (db / 10.0))


def left_by(tile: TileView, distortions: tuple[float, ...]) -> tuple[float, ...]:
    """Squared error of the contents of ``tile`` at each of its LoDs."""
    if tile.kind == TileKind.MOTION:
        finest = max((level for level, size in enumerate(tile.lod_bytes) if size), default=0)
        return tuple(
            min(distortions[-1] * _ratio(LEVEL_DB * max(finest - level, 0)), 1.0) for level in range(tile.max_depth)
        )
    if tile.kind == TileKind.UPDATE:  # LoDs of unchanged attributes have no gain
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
    held = (absent(tile, errors), *levels)[tile.depth]
    layered, overhead = observation.layered, observation.message_overhead_bytes
    left = levels[tile.depth :]
    hull_of = _known_hull if tile.depth or tile.kind == TileKind.LOOKS else _hull
    hull = hull_of(tile.lod_bytes, tile.depth, held, left, overhead=overhead, layered=layered)
    together = _together(observation, tile, errors, (held, *left)) if layered and not tile.depth else 0
    return [_Run(tile, to_lod, slope * value, together) for to_lod, slope in hull]


def _together(observation: Observation, tile: TileView, errors: Errors, levels: tuple[float, ...]) -> int:
    """How many LoDs of a new tile go together; 0 where one will do.

    ``levels`` are the error without the tile and at each of its LoDs. It takes enough LoDs to be better than nothing.
    If the budget suffices, LoDs that are no larger than the headers of a second message are included, and for an update
    enough to be about as good as the looks around it.
    """
    absent, *left = levels
    least = next((lod for lod, error in enumerate(left, start=1) if error < absent), len(left))
    overhead, further = observation.message_overhead_bytes, accumulate(tile.lod_bytes[1 : len(left)])
    wanted = max(
        (lod for lod, size in enumerate(further, 2) if size <= overhead and tile.lod_bytes[lod - 1]), default=1
    )
    if tile.kind == TileKind.UPDATE:
        near = next((lod for lod, error in enumerate(errors.lods, 1) if error <= NEAR * errors.held), len(left))
        wanted = max(wanted, min(near, len(left)))
    fits = sum(tile.lod_bytes[:wanted]) + overhead <= observation.budget_bytes
    together = max(least, wanted) if fits else least
    return together if together > 1 else 0


def _hull(
    sizes: tuple[int, ...], depth: int, held: float, left: tuple[float, ...], *, overhead: int, layered: bool
) -> tuple[tuple[int, float], ...]:
    """(LoD, distortion removed per byte) of the runs from ``depth`` on, for a tile of value 1.

    ``held`` is the distortion at ``depth``, ``left`` that of each LoD from ``depth`` on.
    """
    runs: list[tuple[int, float, float]] = []  # LoDs reached, removed, bytes
    for lod, (before, after) in enumerate(zip((held, *left), left, strict=False), start=depth):
        size = sizes[lod] + (overhead if lod == depth else 0) + 1.0
        if lod and not layered:  # the whole tile is sent again at the better quality
            size = max(size - (sizes[lod - 1] if lod > depth else 0), 1.0)
        to_lod, removed = lod + 1, before - after
        while runs and runs[-1][1] * size <= removed * runs[-1][2]:
            _, more, bytes_before = runs.pop()
            removed, size = removed + more, size + bytes_before
        runs.append((to_lod, removed, size))
    return tuple((to_lod, removed / size) for to_lod, removed, size in runs)


_known_hull = lru_cache(KNOWN_HULLS)(_hull)
