"""Where the splats of a tile are at a time: a chunk of motion evaluated against the tile's own positions and rotations.

The definition, in numpy; the native kernel gives the same bits for positions and rotations. Every operation is a
rounded sum, product, quotient or root of doubles, in the order that is written here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isnan
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cags_kernels
from cags_common.geometry import F32, F64
from cags_common.motion.chunk import Chunk
from cags_common.motion.fades import faded
from cags_common.motion.knots import FRACTION_BITS, I32
from cags_common.motion.parts import in_motion
from cags_common.runtime.threads import threads_for_rows

ABSENT_LOGIT = np.float32(-30.0)
"""Opacity logit of a splat that is not there: drawn opacity 1e-13, which every rasteriser culls."""


@dataclass(frozen=True, slots=True)
class Steps:
    """Units of a tile's residuals, by splat: finest units of the levels, before the fixed point."""

    moves: F32  # [n] metres
    turns: F32  # [n] of a quaternion's imaginary part: half an angle, radians


@dataclass(frozen=True, slots=True)
class Looks:
    """What motion changes of splats: before it, as a tile's levels decode, or at a time."""

    means: F32  # [n, 3] world, metres
    quats: F32  # [n, 4] wxyz, unit, w >= 0
    logit_opacities: F32  # [n] ABSENT_LOGIT for those that are not there

    def take(self, rows: NDArray[Any]) -> Looks:
        """The looks of ``rows``."""
        return Looks(self.means[rows], self.quats[rows], self.logit_opacities[rows])


@dataclass(slots=True, eq=False)
class MovingTile:
    """One tile's part of :func:`move_rows`. A splat belongs to one tile at most.

    Only the time may change between calls, and which rows are left out; what the kernel takes of the rest is made once.
    """

    chunk: Chunk
    time: float
    """Frames from the chunk's first."""
    rows: I32  # [n] row of each splat in the arrays by id; -1: not the tile's any more
    steps: Steps
    prepared: _Prepared | None = None
    """For the kernel; None: to be made."""
    part: MovingTile | None = None
    """See :meth:`in_motion`; None: all of it."""
    parted: bool = False
    """Whether :attr:`part` has been made."""
    ended: int = -1
    """Frame of the chunk up to which rows of splats that have ended are left out; -1: none are."""

    def in_motion(self, since: float | None) -> MovingTile:
        """The part of the tile that the way from ``since``, of the same chunk, to the tile's time changes: all others
        keep what an evaluation at ``since`` gave them, bit by bit. None: from anywhere in the chunk, with splats that
        have ended. The tile itself where that is all of it.
        """
        if not self.parted:
            self.part, self.parted = self._part(), True
        if self.part is None:
            return self
        self.part.time = self.time
        until = -1 if since is None else min(max(int(min(since, self.time)), 0), self.chunk.span)
        self._leave_out_ended(self.part, until)
        return self.part

    def leave_out(self, those: NDArray[np.bool_]) -> None:
        """From now on the tile is without ``those`` [n] of its splats."""
        self.rows[those] = -1
        if self.part is not None:
            of = in_motion(self.chunk)
            self.part.rows[those if of is None else those[of.splats]] = -1

    def _part(self) -> MovingTile | None:
        """What moves, fades or ends at some time of the chunk, with rows of its own; None: all, and nothing ends."""
        of, chunk = in_motion(self.chunk), self.chunk
        if of is not None:
            steps = Steps(self.steps.moves[of.splats], self.steps.turns[of.splats])
            return MovingTile(of.chunk, self.time, self.rows[of.splats], steps)
        if chunk.lives is None or not (chunk.lives <= chunk.span).any():
            return None
        return MovingTile(chunk, self.time, self.rows.copy(), self.steps)

    def _leave_out_ended(self, part: MovingTile, until: int) -> None:
        """Leave out rows of ``part`` whose splats have ended by frame ``until`` of the chunk, and no others."""
        lives = part.chunk.lives
        if lives is None or until == part.ended:
            return
        if until < part.ended:
            of = in_motion(self.chunk)
            part.rows[:] = self.rows if of is None else self.rows[of.splats]
        part.ended = until
        part.rows[lives <= until] = -1


@dataclass(frozen=True, slots=True, eq=False)
class _Prepared:
    """A tile as the kernel takes it, and the arrays that it points to."""

    tile: Any
    native: Any

    def structure(self) -> Any:
        return self.native


def evaluate(chunk: Chunk, time: float, looks: Looks, steps: Steps) -> Looks:
    """The splats [n] of a tile ``time`` frames after the chunk's first, held at its span's end and at their own.

    ``looks`` are the tile's own, as decoded. Between two frames positions follow the line through both, and rotations
    the normalised one. Raises ``ValueError`` for a time that is not a number.
    """
    moment, units = moment_of(chunk, time), _units(chunk, steps)
    with np.errstate(over="ignore", under="ignore"):
        at, rotated = looks.means.astype(np.float64), looks.quats
        if chunk.moves is not None:
            unit = units[0].astype(np.float64) / (1 << FRACTION_BITS)
            at = at + _told(chunk, chunk.moves, moment) * unit[:, None]
        if chunk.turns is not None:
            unit = units[1].astype(np.float64) / (1 << FRACTION_BITS)
            turn = _told(chunk, chunk.turns, moment) * unit[:, None]
            turn[:, 0] += 1.0
            rotated = _canonical(product(_unit(turn), looks.quats.astype(np.float64)))
        return Looks(at.astype(np.float32), rotated, opacities(chunk, moment.time, looks.logit_opacities))


def move_rows(
    tiles: Sequence[MovingTile], looks: Looks, into: Looks, threads: int = 1, *, native: bool | None = None
) -> None:
    """Evaluate the splats of ``tiles``: from rows of ``looks`` to the same rows of ``into``, other arrays by id.

    Arrays by id are C-contiguous float32 [capacity, ...]; no row is in two tiles. ``native`` None takes the kernel
    where there is one, on ``threads``. Raises ``ValueError`` for rows that the arrays do not have and for a time that
    is not a number, and then nothing is written.
    """
    for tile in tiles:
        _check_tile(tile, len(looks.means))
    if cags_kernels.native_available() if native is None else native:
        from cags_kernels import motion

        given, out = ((a.means, a.quats, a.logit_opacities) for a in (looks, into))
        threads = threads_for_rows(sum(tile.chunk.splats for tile in tiles), threads)
        motion.move_rows([_kernel_tile(tile) for tile in tiles], given, out, threads)
        return
    for tile in tiles:
        mine = np.flatnonzero(tile.rows >= 0)
        rows, moved = tile.rows[mine], evaluate(tile.chunk, tile.time, looks.take(np.maximum(tile.rows, 0)), tile.steps)
        into.means[rows] = moved.means[mine]
        into.quats[rows] = moved.quats[mine]
        into.logit_opacities[rows] = moved.logit_opacities[mine]


def _kernel_tile(tile: MovingTile) -> Any:
    moment = moment_of(tile.chunk, tile.time)
    if tile.prepared is None:
        made = _tile_motion(tile, moment)
        tile.prepared = _Prepared(made, made.structure())
    native = tile.prepared.native
    native.time, native.sample, native.share = moment.time, moment.sample, moment.share
    return tile.prepared


def _tile_motion(tile: MovingTile, moment: Moment) -> Any:
    from cags_kernels import motion

    chunk = tile.chunk
    return motion.TileMotion(
        *(chunk.splats, chunk.span, moment.time, moment.sample, moment.share, tile.rows, chunk.moves, chunk.turns),
        *_units(chunk, tile.steps),
        chunk.lives,
        chunk.fades,
    )


def _check_tile(tile: MovingTile, capacity: int) -> None:
    if tile.prepared is not None:  # looked at before; the kernel checks its rows again
        return
    if len(tile.rows) != tile.chunk.splats:
        raise ValueError(f"motion: a tile of {tile.chunk.splats} splats has {len(tile.rows)} rows")
    if int(tile.rows.max(initial=-1)) >= capacity or int(tile.rows.min(initial=0)) < -1:
        raise ValueError(f"motion: rows {tile.rows.min()} to {tile.rows.max()} of arrays of {capacity}")
    moment_of(tile.chunk, tile.time)


def _units(chunk: Chunk, steps: Steps) -> tuple[F32, F32]:
    """Finest units [n] of the chunk's positions and rotations: those of the tile, halved."""
    moves, turns = (np.float32(0.5**halvings) for halvings in chunk.finer)
    return steps.moves * moves, steps.turns * turns


@dataclass(frozen=True, slots=True)
class Moment:
    """A time within a chunk's span: ``share`` of the way from ``sample`` to the next."""

    time: float
    sample: int
    share: float


def moment_of(chunk: Chunk, time: float) -> Moment:
    """``time`` frames from the chunk's first, held within its span. Raises ``ValueError`` for not a number."""
    if isnan(time):
        raise ValueError("motion: the time is not a number")
    time = min(max(time, 0.0), float(chunk.span))
    sample = min(int(time), chunk.span - 1)
    return Moment(time, sample, time - sample)


def _told(chunk: Chunk, samples: I32, moment: Moment) -> F64:
    """What ``samples`` say [n, parts] at ``moment``; of splats that have ended, at their end."""
    out = _between(samples, moment)
    ended = np.flatnonzero(~alive(chunk, moment.time))
    if chunk.lives is not None and len(ended):
        out[ended] = samples[chunk.lives[ended], ended]
    return out


def _between(samples: I32, moment: Moment) -> F64:
    first: F64 = samples[moment.sample].astype(np.float64)
    if moment.share == 0.0:
        return first
    after: F64 = samples[moment.sample + 1].astype(np.float64)
    return first + (after - first) * moment.share


def _unit(quats: F64) -> F64:
    """Quaternions [n, 4] of length one; those without a direction become the identity."""
    w, x, y, z = quats.T
    norms = np.sqrt(((w * w + x * x) + y * y) + z * z)
    lost = ~(norms > 1e-12) | ~np.isfinite(norms)
    out = quats / np.where(lost, 1.0, norms)[:, None]
    out[lost] = (1.0, 0.0, 0.0, 0.0)
    return out


def _canonical(quats: F64) -> F32:
    wide = _unit(quats)
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


def opacities(chunk: Chunk, time: float, logits: F32) -> F32:
    """Opacity logits [n] at a time within the span: after fades, and of those that are there."""
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
    there: NDArray[np.bool_] = (chunk.lives > int(time)) | (chunk.lives == chunk.span + 1)
    return there
