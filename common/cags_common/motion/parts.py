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
    """A chunk of some splats of another one: those in motion."""

    splats: NDArray[np.intp]
    """[m] of the whole chunk, rising."""
    chunk: Chunk


_made: WeakKeyDictionary[Chunk, InMotion | None] = WeakKeyDictionary()
"""Mirrors of a scene share its chunks, and so these."""


def in_motion(chunk: Chunk) -> InMotion | None:
    """The splats that may be elsewhere at another time of the span: their samples differ, they fade, or their lives
    end within it. All others get the same bits at any time. None: most of them are in motion.
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
    lives = None if chunk.lives is None else chunk.lives[splats]
    fades = None if chunk.fades is None else chunk.fades[splats]
    moves, turns = (None if part is None else part.take(splats, axis=1) for part in (chunk.moves, chunk.turns))
    return InMotion(splats, replace(chunk, splats=len(splats), lives=lives, fades=fades, moves=moves, turns=turns))
