"""Where the splats of a tile are at a time: a chunk of motion evaluated against the tile's own positions and rotations.

The definition, in numpy; the native kernel gives the same bits for positions and rotations. Every operation is a
rounded sum, product, quotient or root of doubles, in the order that is written here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32, F64
from cags_common.motion.chunk import TURN_UNIT, Chunk
from cags_common.motion.knots import FRACTION_BITS, I32

ABSENT_LOGIT = np.float32(-30.0)
"""Opacity logit of a splat that is not there: drawn opacity 1e-13, which every rasteriser culls."""


@dataclass(frozen=True, slots=True)
class Steps:
    """Units of a tile's residuals, by splat: finest units of the levels, before the fixed point."""

    moves: F32  # [n] metres
    turns: F32  # [n] of a quaternion's imaginary part: half an angle, radians


@dataclass(frozen=True, slots=True)
class Moved:
    """A tile's splats at one time."""

    means: F32  # [n, 3] world, metres
    quats: F32  # [n, 4] wxyz, unit, w >= 0
    logit_opacities: F32  # [n] ABSENT_LOGIT for those that are not there


def evaluate(chunk: Chunk, time: float, means: F32, quats: F32, logits: F32, steps: Steps) -> Moved:
    """The splats [n] of a tile ``time`` frames after the chunk's first, held at its span's end.

    ``means``, ``quats``, ``logits`` are the tile's own, as decoded. Between two frames positions follow the line
    through both, and rotations the normalised one.
    """
    time = min(max(time, 0.0), float(chunk.span))
    sample = min(int(time), chunk.span - 1) if time > 0 else 0
    share = time - sample
    at, turned = _rigid(chunk, sample, share, means, quats)
    if chunk.moves is not None:
        unit = steps.moves.astype(np.float64) / (1 << FRACTION_BITS)
        at = at + _between(chunk.moves, sample, share) * unit[:, None]
    if chunk.turns is not None:
        unit = steps.turns.astype(np.float64) / (1 << FRACTION_BITS)
        turn = _between(chunk.turns, sample, share) * unit[:, None]
        turn[:, 0] += 1.0
        turned = product(_unit(turn), turned)
    rotated = quats if turned is quats else _canonical(turned)
    return Moved(at.astype(np.float32), rotated, _opacities(chunk, time, logits))


def _between(samples: I32, sample: int, share: float) -> F64:
    first = samples[sample].astype(np.float64)
    if share == 0.0:
        return first
    return first + (samples[sample + 1].astype(np.float64) - first) * share


def _rigid(chunk: Chunk, sample: int, share: float, means: F32, quats: F32) -> tuple[F64, F64 | F32]:
    """Positions and rotations, not unit, as the blocks carry them."""
    blocks, wide = chunk.blocks, means.astype(np.float64)
    if blocks is None:
        return wide, quats
    of = np.arange(len(means)) // blocks.size
    turns = _unit_of_gibbs(_between(blocks.turns, sample, share) * TURN_UNIT)
    shifts = _between(blocks.shifts, sample, share) * float(np.float32(blocks.unit))
    return rotate(turns[of], wide) + shifts[of], product(turns[of], quats.astype(np.float64))


def _unit_of_gibbs(gibbs: F64) -> F64:
    """Unit quaternions [n, 4] of Gibbs vectors [n, 3]."""
    return _unit(np.concatenate([np.ones((len(gibbs), 1)), gibbs], axis=1))


def _unit(quats: F64) -> F64:
    """Quaternions [n, 4] of length one; those without a direction become the identity."""
    w, x, y, z = quats.T
    norms = np.sqrt(((w * w + x * x) + y * y) + z * z)
    lost = ~(norms > 1e-12) | ~np.isfinite(norms)
    out = quats / np.where(lost, 1.0, norms)[:, None]
    out[lost] = (1.0, 0.0, 0.0, 0.0)
    return out


def _canonical(quats: F64 | F32) -> F32:
    wide = _unit(quats.astype(np.float64))
    return np.ascontiguousarray(np.where(wide[:, :1] < 0, -wide, wide), dtype=np.float32)


def product(a: F64, b: F64) -> F64:
    """Quaternion products [n, 4] of ``a`` after ``b``: sums from left to right."""
    w1, x1, y1, z1 = a.T
    w2, x2, y2, z2 = b.T
    return np.stack(
        [
            ((w1 * w2 - x1 * x2) - y1 * y2) - z1 * z2,
            ((w1 * x2 + x1 * w2) + y1 * z2) - z1 * y2,
            ((w1 * y2 - x1 * z2) + y1 * w2) + z1 * x2,
            ((w1 * z2 + x1 * y2) - y1 * x2) + z1 * w2,
        ],
        axis=1,
    )


def rotate(quats: F64, points: F64) -> F64:
    """``points`` [n, 3] turned by unit ``quats`` [n, 4]: p + 2 (w (v x p) + v x (v x p))."""
    w, x, y, z = quats.T
    px, py, pz = points.T
    cx, cy, cz = y * pz - z * py, z * px - x * pz, x * py - y * px
    return np.stack(
        [
            px + 2.0 * (w * cx + (y * cz - z * cy)),
            py + 2.0 * (w * cy + (z * cx - x * cz)),
            pz + 2.0 * (w * cz + (x * cy - y * cx)),
        ],
        axis=1,
    )


def _opacities(chunk: Chunk, time: float, logits: F32) -> F32:
    out = logits
    if chunk.fades is not None:
        out = faded(chunk.fades, time, logits)
    if chunk.lives is not None:
        out = np.where(alive(chunk, time), out, ABSENT_LOGIT).astype(np.float32)
    return out


def alive(chunk: Chunk, time: float) -> NDArray[np.bool_]:
    """Whether each splat [n] is there: before the last frame of its life has passed."""
    if chunk.lives is None:
        return np.ones(chunk.splats, bool)
    return (chunk.lives.astype(np.float64) > time) | (chunk.lives == chunk.span + 1)


def faded(fades: F32, time: float, logits: F32) -> F32:
    """Opacity logits [n] after fades [n, 2]: opacities times a Gaussian of the time."""
    rows = np.flatnonzero(np.isfinite(fades[:, 1]))
    if not len(rows):
        return logits
    away = (np.float64(time) - fades[rows, 0]) / fades[rows, 1]
    opacity = np.exp(-0.5 * away * away) / (1.0 + np.exp(-logits[rows].astype(np.float64)))
    inside = np.clip(opacity, 1e-9, 1 - 1e-7)
    out = logits.copy()
    out[rows] = np.log(inside / (1.0 - inside)).astype(np.float32)
    return out
