"""Chunks of motion: from where the splats of a tile truly are over a span of frames to payloads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle import TilePayloads
from cags_common.geometry import F32, F64
from cags_common.motion import chunk
from cags_common.motion.apply import Steps, product
from cags_common.motion.chunk import Blocks
from cags_common.tile_kinds import TileKind
from cags_encoder.frames.tiling import corners
from cags_encoder.motion.rigid import carried, rigid_blocks
from cags_encoder.motion.turns import CONJUGATE, relative_turns

BLOCK = 128
"""Splats that move as one rigid body before their own residuals."""

STRAIGHT = 1.0
"""A trajectory within so many finest units of a line is told as the line."""

ROUND = 1.05
"""Ratio of a splat's longest to its shortest axis below which nobody sees it turn."""

LEAST_UNITS = 0.5
"""Residuals below this round to nothing."""

MOST_UNITS = float(1 << 21)
"""Bound on residuals, in finest units: larger motion is another splat's."""


@dataclass(frozen=True, eq=False)
class TrackSpan:
    """What the splats [n] of one tile of looks do over ``span`` + 1 frames. Rows that are not present hold anything."""

    looks: tuple[int, int]
    means: F32  # [span + 1, n, 3] world, metres
    quats: F32  # [span + 1, n, 4]
    present: NDArray[np.bool_]  # [span + 1, n]
    anchors: F32  # [n, 3] the looks' positions, as decoded
    first: F32  # [n, 4] the rotations that the looks came with
    steps: Steps
    round: NDArray[np.bool_]  # [n] whose turns nobody sees
    starts: bool
    """Whether the span begins after the looks do."""
    lives: NDArray[np.uint8] | None  # [n]
    fades: NDArray[np.int64] | None  # [n, 2]

    @property
    def span(self) -> int:
        """Frames after the first."""
        return len(self.means) - 1


def encode_span(span: TrackSpan) -> TilePayloads:
    """The payloads of a span's chunk."""
    moves, anchors = _filled(span), span.anchors.astype(np.float64)
    unit = span.steps.moves.astype(np.float64)[None, :, None]
    turns = _turns(span)
    blocks = _worthwhile(span, anchors, moves)
    if blocks is not None:
        base, block_turns = carried(blocks, anchors)
        turns = _beside(np.broadcast_to(np.eye(4)[0], block_turns.shape) if turns is None else turns, block_turns)
    else:
        base = anchors[None]
    residuals = _straight(np.clip((moves - base) / unit, -MOST_UNITS, MOST_UNITS), span.present)
    rotations = None if turns is None else _turn_residuals(span, turns)
    if rotations is None or np.abs(residuals).max(initial=0.0) > LEAST_UNITS:
        told: F64 | None = residuals
    else:
        told = None
    payloads = chunk.encode(
        span.looks, told, rotations, starts=span.starts, lives=span.lives, fades=span.fades, blocks=blocks
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
    """Turns [span + 1, n, 4] from the rotations of the looks; None where nothing turns."""
    differs = np.zeros(span.present.shape, bool)
    for part in range(4):
        differs |= span.quats[:, :, part] != span.first[:, part]
    seen = np.logical_and(span.present, np.logical_not(span.round))
    if not bool(np.logical_and(differs, seen).any()):
        return None
    return relative_turns(span.quats.astype(np.float64), span.first.astype(np.float64))


def _filled(span: TrackSpan) -> F64:
    """Positions [span + 1, n, 3] that go on along a line where a splat is not there."""
    means = np.where(span.present[:, :, None], span.means, span.anchors[None]).astype(np.float64)
    if span.present.all():
        return means
    line = _line(means, span.present)
    alive = np.logical_or.reduce(span.present, axis=0)
    filled: F64 = np.where(span.present[:, :, None] | ~alive[None, :, None], means, line)
    return filled


def _line(values: F64, present: NDArray[np.bool_]) -> F64:
    """The line [frames, n, c] through ``values`` [frames, n, c] where ``present``, by least squares."""
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


def _straight(values: F64, present: NDArray[np.bool_]) -> F64:
    """``values`` [frames, n, c] in finest units, with those that are within :data:`STRAIGHT` of a line put on it."""
    line = _line(values, present)
    off = np.where(present[:, :, None], np.abs(values - line), 0.0).max(axis=(0, 2))
    out: F64 = np.where((off <= STRAIGHT)[None, :, None], line, values)
    return out


def _turn_residuals(span: TrackSpan, turns: F64) -> F64 | None:
    """Turns [span + 1, n, 4] against the identity in finest units, or None where nobody would see them."""
    units = (turns - np.eye(4)[0]) / span.steps.turns.astype(np.float64)[None, :, None]
    units[:, span.round] = 0.0
    if not span.present.all():
        last = span.span - span.present[::-1].argmax(axis=0)
        units = np.where(span.present[:, :, None], units, units[last, np.arange(units.shape[1])][None])
    units = _straight(np.clip(units, -MOST_UNITS, MOST_UNITS), span.present)
    return units if np.abs(units).max(initial=0.0) > LEAST_UNITS else None


def _beside(turns: F64, blocks: F64) -> F64:
    """What is left of ``turns`` [frames, n, 4] after those of the blocks, its first sample with w >= 0."""
    flat = (-1, 4)
    left = product(turns.reshape(flat), (blocks * CONJUGATE).reshape(flat)).reshape(turns.shape)
    for at in range(1, len(left)):
        left[at] *= np.where((left[at] * left[at - 1]).sum(axis=1) < 0, -1.0, 1.0)[:, None]
    signed: F64 = left * np.where(left[:1, :, :1] < 0, -1.0, 1.0)
    return signed


def _worthwhile(span: TrackSpan, anchors: F64, moves: F64) -> Blocks | None:
    """Rigid blocks, where they save more than they cost (judged at the ends and in the middle)."""
    unit = float(np.float32(max(float(np.percentile(span.steps.moves, 10)), 1e-30)))
    some = moves[[span.span // 2, span.span]]
    weights = np.asarray(span.present.any(axis=0), np.float64) + 1e-9
    tried = rigid_blocks(anchors, some, weights, BLOCK, unit)
    base, _ = carried(tried, anchors)
    moves_unit = span.steps.moves[None, :, None]

    def bits(left: F64) -> float:
        return float(np.log2(1.0 + np.abs(left / moves_unit)).sum())

    saved = bits(some - anchors[None]) - bits(some - base)
    if saved <= 1.5 * 6 * 8 * len(some) * (-(-len(anchors) // BLOCK)):
        return None
    return rigid_blocks(anchors, moves, weights, BLOCK, unit)
