"""The part of a chunk of motion that hangs on the time, by itself: only that is evaluated frame by frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from cags_common.motion.chunk import Chunk
from cags_common.motion.knots import I32

MOST_IN_MOTION = 0.875
"""Share of a chunk's splats in motion above which all of them count as such: leaving the others out costs more."""


@dataclass(frozen=True, slots=True, eq=False)
class InMotion:
    """A chunk of some splats of another one. Blocks stay whole, so it may speak of more than are in motion."""

    splats: NDArray[np.intp]
    """[m] of the whole chunk, rising: those in motion."""
    taken: NDArray[np.intp]
    """[k] of the whole chunk, rising: those that :attr:`chunk` speaks of, all of ``splats`` among them."""
    chunk: Chunk


_made: WeakKeyDictionary[Chunk, InMotion | None] = WeakKeyDictionary()
"""Mirrors of a scene share its chunks, and so these."""


def in_motion(chunk: Chunk) -> InMotion | None:
    """The splats that may be elsewhere at another time of the span: their samples or those of their blocks differ, they
    fade, or their lives end within it. All others get the same bits at any time. None: most of them are in motion.
    Worked out once a chunk.
    """
    if chunk not in _made:
        _made[chunk] = _in_motion(chunk)
    return _made[chunk]


def _in_motion(chunk: Chunk) -> InMotion | None:
    found = np.zeros(chunk.splats, bool)
    if chunk.fades is not None:
        found |= np.isfinite(chunk.fades[:, 1])
    if chunk.lives is not None:
        found |= chunk.lives <= chunk.span
    if chunk.blocks is not None:
        moving = [_varies(part, part.shape[1]) for part in (chunk.blocks.shifts, chunk.blocks.turns)]
        found |= (moving[0] | moving[1])[np.arange(chunk.splats) // chunk.blocks.size]
    for part in (chunk.moves, chunk.turns):
        if part is not None and not _most(found):
            found |= _varies(part, chunk.splats)
    return None if _most(found) else _part(chunk, np.flatnonzero(found))


def _most(found: NDArray[np.bool_]) -> bool:
    return int(found.sum()) > MOST_IN_MOTION * len(found)


def _varies(samples: I32, count: int) -> NDArray[np.bool_]:
    """Whether ``samples`` [span + 1, count, parts] of each [count] are not all the same."""
    differ: NDArray[np.bool_] = (samples != samples[0]).any(axis=0).reshape(count, -1).any(axis=1)
    return differ


def _part(chunk: Chunk, splats: NDArray[np.intp]) -> InMotion:
    blocks, taken = chunk.blocks, splats
    if blocks is not None:
        kept = np.unique(splats // blocks.size)
        taken = (kept[:, None] * blocks.size + np.arange(blocks.size)).ravel()
        taken = taken[taken < chunk.splats]
        blocks = replace(blocks, shifts=blocks.shifts.take(kept, axis=1), turns=blocks.turns.take(kept, axis=1))
    lives = None if chunk.lives is None else chunk.lives[taken]
    fades = None if chunk.fades is None else chunk.fades[taken]
    moves, turns = (None if part is None else part.take(taken, axis=1) for part in (chunk.moves, chunk.turns))
    some = replace(chunk, splats=len(taken), lives=lives, fades=fades, blocks=blocks, moves=moves, turns=turns)
    return InMotion(splats, taken, some)
