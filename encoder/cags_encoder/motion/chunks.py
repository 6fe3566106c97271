"""Encodes chunks of motion: from the true motion of a tile's splats over a span of frames to payloads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle import TilePayloads
from cags_common.geometry import F32, F64
from cags_common.motion import chunk
from cags_common.motion.apply import Steps
from cags_common.motion.chunk import DEADZONES, LEVELS, MAX_FINER, REFINEMENT
from cags_common.motion.knots import FRACTION_BITS, knots
from cags_common.motion.neighbours import Anchors, Neighbours
from cags_common.motion.symbols import Samples, SymbolWriter, Tree
from cags_common.tiles.kinds import TileKind
from cags_encoder.motion.smoothing import smoothed
from cags_encoder.motion.tolerance import Tolerance, Tolerances
from cags_encoder.motion.turns import relative_turns
from cags_encoder.tiling import corners

STRAIGHT = 1.0
"""A trajectory within this many finest units of a line is coded as the line."""

ROUGH = 0.75
"""Ends of lines are rounded to a coarser level's unit if no sample is then wrong by more finest units than this."""

MOST_MOVED, MOST_TURNED = 1.0, 3.0
"""Largest change of any sample of positions and rotations by smoothing, in finest units, so that it is invisible."""

ROUND = 1.05
"""Ratio of a splat's longest to its shortest axis below which its rotation is invisible."""

JUDGED, RUN = 1024, 128
"""Number of splats from which a chunk's accuracy is determined, in runs of neighbours."""

LEAST_UNITS = 0.5
"""Smaller residuals round to zero."""

MOST_UNITS = float(1 << 23)
"""Largest residual, in finest units. Splats do not get further from their looks, because they count as others first
(:data:`cags_encoder.tracks.placing.FARTHEST`); lines that continue the motion of splats that have ended may.
"""

BASE_ZONES, LAST_ZONES = (0.5, 0.35, 0.2, 0.1, 0.0), (0.5, 0.35, 0.2, 0.1)
"""Dead zones of the base and of the last level, from the fewest bytes on. All are tried before units are halved."""

BASE_LEVELS = 3
"""Levels from the base on: 1, 1/4 and 1/16 of a standard deviation, halved together as often as a chunk needs."""

COARSE = (LEVELS - BASE_LEVELS) * (REFINEMENT.bit_length() - 1)
"""Halvings from which on a coarser level precedes the base. It is not coarser than a standard deviation either."""


@dataclass(frozen=True, eq=False)
class TrackSpan:
    """Motion of the splats [n] of one tile of looks over ``span`` + 1 frames; rows not present are undefined."""

    looks: tuple[int, int]
    means: F32  # [span + 1, n, 3] world, metres
    quats: F32  # [span + 1, n, 4]
    present: NDArray[np.bool_]  # [span + 1, n]
    anchors: F32  # [n, 3] the looks' decoded positions, of every level
    coarse: F32  # [n, 3] those of level 0, by which motion is told
    first: F32  # [n, 4] rotations when the looks were sent
    steps: Steps
    round: NDArray[np.bool_]  # [n] whose rotations are invisible
    starts: bool
    """Whether the span begins after the looks."""
    lives: NDArray[np.uint8] | None  # [n]
    fades: NDArray[np.int64] | None  # [n, 2]
    tolerances: Tolerances = field(default_factory=Tolerances)

    @property
    def span(self) -> int:
        """Number of frames after the first."""
        return len(self.means) - 1

    def trajectories(self, values: F64, *, turn: bool) -> Trajectories:
        """``values`` [span + 1, n, c] of all splats, to be told."""
        return Trajectories(values, Anchors(self.coarse, self.steps.moves, self.steps.turns), self.starts, turn)


@dataclass(frozen=True)
class Exactness:
    """Accuracy of a chunk's positions, or rotations."""

    finer: int = 0
    """How often the tile's units are halved."""
    told: int = LEVELS
    """Number of levels that are not empty."""
    coarse: bool = False
    """Whether level 0 is coarser than the base."""
    zones: tuple[float, ...] = DEADZONES[:BASE_LEVELS]
    """Dead zones of the levels from the base on."""

    @property
    def step(self) -> int:
        """Finest units of the chunk per unit of the last level that is not empty."""
        return int(REFINEMENT ** (LEVELS - self.told))

    @property
    def deadzones(self) -> tuple[float, ...]:
        """Dead zone of each level."""
        return (DEADZONES[0], *self.zones) if self.coarse else (*self.zones, DEADZONES[-1])

    def scaled(self, values: F64) -> F64:
        """``values``, given in the tile's units, in units of the last level that is not empty."""
        most = MOST_UNITS / self.step
        out: F64 = np.clip(values * (2.0**self.finer / self.step), -most, most)
        return out


@dataclass(frozen=True, eq=False)
class Trajectories:
    """Positions or rotations of some splats, to be told."""

    values: F64  # [frames, n, c] less those of the looks
    anchors: Anchors  # [n]
    starts: bool
    turn: bool

    def take(self, rows: NDArray[np.intp]) -> Trajectories:
        """Those of ``rows``."""
        return replace(self, values=np.ascontiguousarray(self.values[:, rows]), anchors=self.anchors.take(rows))

    def samples(self, *, curved: bool = False) -> Samples:
        """Nothing told of it yet."""
        span = len(self.values) - 1
        order = knots(span, start=self.starts, curved=curved)
        return Samples.untold(Tree.of(order, self.anchors, Neighbours.of(self.anchors), turn=self.turn), span)


def some(rows: NDArray[np.intp]) -> NDArray[np.intp]:
    """About :data:`JUDGED` of ``rows``, in runs of neighbours, which predict each other."""
    every = max(1, len(rows) // JUDGED)
    chosen: NDArray[np.intp] = rows[np.arange(len(rows)) // RUN % every == 0]
    return chosen


def _judged(values: F64, present: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Splats whose errors determine the accuracy: all that are present or, if fewer than half of them move, those that
    move. The others have hardly any error and would lower the mean.
    """
    there = present.any(axis=0)
    moving = (present & (np.abs(values) > LEAST_UNITS).any(axis=2)).any(axis=0)
    few = 0 < 2 * np.count_nonzero(moving) < np.count_nonzero(there)
    rows: NDArray[np.intp] = np.flatnonzero(moving if few else there)
    return rows


def exactness(tracks: Trajectories, present: NDArray[np.bool_], tolerance: Tolerance) -> Exactness:
    """The accuracy for ``tracks``, in the tile's units, whose errors are within ``tolerance`` where ``present``.

    The base is level 0, or level 1 if it is so exact that a coarser level is worth having.
    """
    largest = float(np.abs(tracks.values).max(where=present[:, :, None], initial=1.0))
    rows = some(_judged(tracks.values, present))
    judged, present = tracks.take(rows), present[:, rows]
    told, values = judged.samples(), judged.values
    most = int(np.clip(np.log2(MOST_UNITS / largest) - COARSE, 0, MAX_FINER - COARSE))

    def error(finer: int, level: int, zone: float) -> float:
        """With the base alone (0), or so many levels more."""
        wanted, copy = np.clip(values, -MOST_UNITS, MOST_UNITS) * 2.0**finer, told.copy()
        SymbolWriter().tree(copy, wanted, REFINEMENT ** (BASE_LEVELS - 1 - level), zone)
        off: F64 = (wanted - copy.values / (1 << FRACTION_BITS))[present] * 2.0**-finer
        return float(np.sqrt(np.square(off).mean())) if off.size else 0.0

    def within(limit: float, halvings: range, level: int, zones: Sequence[float]) -> tuple[int, float]:
        """The fewest halvings and the largest dead zone of ``level`` whose error is within the ``limit``."""
        tried = ((finer, zone) for finer in halvings for zone in zones)
        return next((t for t in tried if error(t[0], level, t[1]) <= limit), (halvings[-1], zones[-1]))

    finer, base = within(tolerance.base, range(most + 1), 0, BASE_ZONES)
    coarse = finer >= COARSE

    def found(levels: int, last: float = DEADZONES[BASE_LEVELS - 1]) -> Exactness:
        halvings, told = (finer, levels + 1) if coarse else (finer + COARSE, levels)
        return Exactness(halvings, told, coarse, (base, DEADZONES[1], last))

    for level in range(BASE_LEVELS - 1):
        if error(finer, level, DEADZONES[level]) <= tolerance.spare:
            return found(level + 1)
    finer, last = within(tolerance.top, range(finer, most + 1), BASE_LEVELS - 1, LAST_ZONES)
    _, base = within(tolerance.base, range(finer, finer + 1), 0, BASE_ZONES)
    return found(BASE_LEVELS, last)


def curved(tracks: Trajectories, exact: Exactness) -> bool:
    """Whether coding middles against curves takes fewer bytes than against lines for ``tracks``.

    Curves pass through more samples and so amplify noise. Determined from some splats, with a single level.
    """
    if len(tracks.values) < 4 or not exact.told:
        return False
    judged = tracks.take(some(np.flatnonzero((tracks.values != 0).any(axis=(0, 2)))))

    def size(bent: bool) -> int:
        writer = SymbolWriter()
        writer.tree(judged.samples(curved=bent), judged.values, exact.step, exact.deadzones[exact.told - 1])
        return sum(map(len, writer.to_bytes()))

    return judged.values.size > 0 and size(True) < size(False)


def encode_span(span: TrackSpan) -> TilePayloads:
    """Payloads of a span's chunk."""
    moves, anchors = _filled(span), span.anchors.astype(np.float64)
    unit = span.steps.moves.astype(np.float64)[None, :, None]
    turns = _turns(span)
    residuals = (moves - anchors[None]) / unit
    exact = exactness(span.trajectories(residuals, turn=False), span.present, span.tolerances.moves)
    residuals = smoothed(exact.scaled(residuals), MOST_MOVED, starts=span.starts)
    residuals = _straight(residuals, span.present, exact.told, starts=span.starts) * exact.step
    rotations, turned = (None, Exactness()) if turns is None else _turn_residuals(span, turns)
    told = span.trajectories(residuals, turn=False)
    moving = rotations is None or np.abs(residuals).max(initial=0.0) > LEAST_UNITS
    payloads = chunk.encode(
        *(span.looks, told.anchors, residuals if moving else None, None if rotations is None else rotations.values),
        starts=span.starts,
        lives=span.lives,
        fades=span.fades,
        finer=(exact.finer, turned.finer),
        told=(exact.told, turned.told),
        curved=(moving and curved(told, exact), rotations is not None and curved(rotations, turned)),
        deadzones=(exact.deadzones, turned.deadzones),
    )
    shown = moves[span.present]
    return TilePayloads(
        len(anchors),
        None,
        corners(shown.astype(np.float32) if len(shown) else span.anchors),
        payloads,
        TileKind.MOTION,
        span.looks,
        span.span,
    )


def _turns(span: TrackSpan) -> F64 | None:
    """Rotations [span + 1, n, 4] relative to those of the looks; None if nothing rotates."""
    differs = np.zeros(span.present.shape, bool)
    for part in range(4):
        differs |= span.quats[:, :, part] != span.first[:, part]
    seen = np.logical_and(span.present, np.logical_not(span.round))
    if not bool(np.logical_and(differs, seen).any()):
        return None
    return relative_turns(span.quats.astype(np.float64), span.first.astype(np.float64))


def _filled(span: TrackSpan) -> F64:
    """Positions [span + 1, n, 3]; splats that are not present continue along a line."""
    means = np.where(span.present[:, :, None], span.means, span.anchors[None]).astype(np.float64)
    if span.present.all():
        return means
    line = _line(means, span.present)
    alive = np.logical_or.reduce(span.present, axis=0)
    filled: F64 = np.where(span.present[:, :, None] | ~alive[None, :, None], means, line)
    return filled


def _line(values: F64, present: NDArray[np.bool_]) -> F64:
    """The least-squares line [frames, n, c] through ``values`` [frames, n, c] where ``present``."""
    times = np.arange(len(values), dtype=np.float64)[:, None]
    weights = present.astype(np.float64)
    total = np.maximum(weights.sum(axis=0), 1.0)
    mean_t = (weights * times).sum(axis=0) / total
    away = weights * (times - mean_t)
    spread = np.maximum((away * (times - mean_t)).sum(axis=0), 1e-12)
    mean = (weights[:, :, None] * values).sum(axis=0) / total[:, None]
    slope = (away[:, :, None] * (values - mean)).sum(axis=0) / spread[:, None]
    line: F64 = mean + (times - mean_t)[:, :, None] * slope
    return line


def _straight(values: F64, present: NDArray[np.bool_], levels: int, *, starts: bool) -> F64:
    """``values`` [frames, n, c] in units of the last of ``levels``, those within :data:`STRAIGHT` of a line put on it.

    Without ``starts`` lines begin at zero, where the client has the splats. Both ends are rounded to the unit of a
    coarser level where accuracy allows, so that finer levels code zeros: a short life needs no exact end of the span.
    """
    line = _line(values, present) if starts else _line_from_nothing(values, present)
    times = np.arange(len(values), dtype=np.float64)[:, None, None] / (len(values) - 1)
    seen = present[:, :, None] & (times >= (0.0 if starts else 1e-9))

    def off(tried: F64) -> F64:
        furthest: F64 = np.where(seen, np.abs(values - tried), 0.0).max(axis=0)
        return furthest

    straight: NDArray[np.bool_] = np.logical_and.reduce(off(line) <= STRAIGHT, axis=1)
    rough = np.rint(line[0] / REFINEMENT) * REFINEMENT
    first = np.where((levels > 1) & (np.abs(rough - line[0]) <= ROUGH), rough, np.rint(line[0]))
    chosen = first + np.rint(line[-1] - first) * times
    limit = np.maximum(off(chosen), ROUGH)
    for unit in (REFINEMENT**level for level in range(1, levels)):
        rounder = first + np.rint((line[-1] - first) / unit) * unit * times
        chosen = np.where(off(rounder) <= limit, rounder, chosen)
    return np.where(straight[:, None], chosen, values)


def _line_from_nothing(values: F64, present: NDArray[np.bool_]) -> F64:
    """The least-squares line [frames, n, c] from zero through ``values`` [frames, n, c] where ``present``."""
    times = np.arange(len(values), dtype=np.float64)[:, None]
    weights = np.where(present, times, 0.0)
    slope = (weights[:, :, None] * values).sum(axis=0) / np.maximum((weights * times).sum(axis=0), 1e-12)[:, None]
    line: F64 = times[:, :, None] * slope
    return line


def _turn_residuals(span: TrackSpan, turns: F64) -> tuple[Trajectories | None, Exactness]:
    """Rotations [span + 1, n, 4] minus the identity in the chunk's finest units, or None if they are invisible."""
    units = (turns - np.eye(4)[0]) / span.steps.turns.astype(np.float64)[None, :, None]
    units[:, span.round] = 0.0
    if not span.present.all():
        last = span.span - span.present[::-1].argmax(axis=0)
        units = np.where(span.present[:, :, None], units, units[last, np.arange(units.shape[1])][None])
    exact = exactness(span.trajectories(units, turn=True), span.present, span.tolerances.turns)
    units = smoothed(exact.scaled(units), MOST_TURNED, starts=span.starts)
    units = _straight(units, span.present, exact.told, starts=span.starts) * exact.step
    told = np.abs(units).max(initial=0.0) > LEAST_UNITS
    return span.trajectories(units, turn=True) if told else None, exact
