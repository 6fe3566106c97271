"""The part of a chunk in motion: everything else has the same bits at any time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cags_common.motion.apply import Looks, Steps, evaluate
from cags_common.motion.chunk import Chunk
from cags_common.motion.parts import MOST_IN_MOTION, in_motion

SPAN, SPLATS = 4, 16
STEPS = Steps(np.full(SPLATS, 0.5, np.float32), np.full(SPLATS, 0.25, np.float32))


def chunk(moving: list[int] = [], **parts: object) -> Chunk:  # noqa: B006 - read, not written
    moves = np.zeros((SPAN + 1, SPLATS, 3), np.int32)
    moves[:, :, 1] = 640  # off its look, but there at any time
    moves[2, moving, 0] = 64
    return replace(Chunk((0, 0), SPAN, SPLATS, None, None, moves, None, True), **parts)  # type: ignore[arg-type]


def looks(rows: np.ndarray) -> Looks:
    random = np.random.default_rng(2)
    quats = np.tile(np.float32([1, 0, 0, 0]), (SPLATS, 1))
    means, logits = (random.normal(size=size).astype(np.float32) for size in ((SPLATS, 3), (SPLATS,)))
    return Looks(means[rows], quats[rows], logits[rows])


def test_only_what_moves_is_named() -> None:
    part = in_motion(chunk([3, 9]))
    assert part is not None
    assert part.splats.tolist() == [3, 9]
    assert part.chunk.splats == 2


def test_lives_that_end_and_fades_count_as_motion() -> None:
    lives = np.full(SPLATS, SPAN + 1, np.int32)
    lives[5] = SPAN
    part = in_motion(chunk(lives=lives))
    assert part is not None and part.splats.tolist() == [5]


@pytest.mark.parametrize("time", [0.0, 0.5, 2.0, 3.25, 4.0])
def test_the_part_has_the_bits_of_the_whole_and_the_rest_stands_still(time: float) -> None:
    whole = chunk([1, 7, 8])
    part = in_motion(whole)
    assert part is not None
    everything, at_start = (evaluate(whole, t, looks(np.arange(SPLATS)), STEPS) for t in (time, 0.0))
    steps = Steps(STEPS.moves[part.splats], STEPS.turns[part.splats])
    some = evaluate(part.chunk, time, looks(part.splats), steps)
    assert np.array_equal(some.means, everything.means[part.splats])
    rest = np.setdiff1d(np.arange(SPLATS), part.splats)
    assert np.array_equal(everything.means[rest], at_start.means[rest])


def test_a_chunk_that_mostly_moves_is_taken_whole_and_the_answer_is_kept() -> None:
    most = list(range(int(MOST_IN_MOTION * SPLATS) + 1))
    assert in_motion(chunk(most)) is None
    assert in_motion(chunk(most[:-1])) is not None
    few = chunk([1])
    assert in_motion(few) is in_motion(few)
