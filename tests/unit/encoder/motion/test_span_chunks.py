"""Encoding of chunks of motion: linear motion costs little, and accuracy follows a splat's life."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cags_common.motion import chunk as chunks
from cags_common.motion.apply import Looks, Steps, evaluate
from cags_common.motion.chunk import ChunkDecoder
from cags_common.motion.neighbours import Anchors
from cags_common.tiles.morton import morton_order
from cags_encoder.motion.chunks import JUDGED, STRAIGHT, TrackSpan, encode_span
from cags_encoder.motion.steps import MOVE_STEP
from cags_encoder.motion.tolerance import Tolerance, Tolerances

SPAN, SPLATS, STEP = 16, 64, 0.01


def drifting(lives: np.ndarray, noise: float, **options: Any) -> TrackSpan:
    """Splats [n] over some frames that drift in straight lines, up to ``noise`` units off their held positions."""
    random = np.random.default_rng(2)
    times = np.arange(SPAN + 1)[:, None, None]
    anchors = random.normal(size=(len(lives), 3)).astype(np.float32)
    first = anchors + random.uniform(-noise, noise, anchors.shape) * STEP
    means = (first + times * random.normal(size=anchors.shape) * STEP).astype(np.float32)
    quats = np.tile(np.array([1, 0, 0, 0], np.float32), (SPAN + 1, len(lives), 1))
    still = np.zeros(len(lives), bool)
    steps = Steps(*(np.full(len(lives), STEP, np.float32) for _ in range(2)))
    present = np.arange(SPAN + 1)[:, None] < lives
    told = np.minimum(lives, SPAN + 1).astype(np.uint8)
    given = {"starts": False, "lives": None if present.all() else told, "fades": None, **options}
    coarse = (np.rint(anchors * 8) / 8).astype(np.float32)
    return TrackSpan((0, 0), means, quats, present, anchors, coarse, quats[0], steps, still, **given)


def anchors_of(span: TrackSpan) -> Anchors:
    return Anchors(span.coarse, span.steps.moves, span.steps.turns)


def decoded(span: TrackSpan) -> chunks.Chunk:
    payloads = encode_span(span).payloads
    decoder = ChunkDecoder(payloads[0], anchors_of(span))
    for payload in payloads[1:]:
        decoder.add_level(payload)
    return decoder.chunk


@pytest.mark.parametrize("starts", [False, True])
@pytest.mark.parametrize("longest", [2, 5, SPAN + 2])
def test_lines_of_any_life_are_within_a_unit_where_they_are_seen(starts: bool, longest: int) -> None:
    lives = np.random.default_rng(3).integers(1, longest, SPLATS)
    span = drifting(lives, 0.7, starts=starts)
    chunk = decoded(span)
    assert chunk.moves is not None
    off = np.abs((span.means - span.anchors) / STEP - chunk.moves / 64 / 2 ** chunk.finer[0])
    seen = span.present[:, :, None] & (starts | (np.arange(SPAN + 1)[:, None, None] > 0))
    assert np.where(seen, off, 0.0).max() <= STRAIGHT + 0.5 + chunks.DEADZONES[-1]


def test_what_a_splat_is_off_when_it_comes_is_not_told() -> None:
    lives = np.full(SPLATS, SPAN + 1)
    exact, off = (sum(map(len, encode_span(drifting(lives, noise)).payloads)) for noise in (0.0, 0.7))
    assert off <= 1.15 * exact


def test_a_short_life_needs_no_exact_end_of_the_span() -> None:
    long, short = (encode_span(drifting(np.full(20 * SPLATS, life), 0.0)).payloads for life in (SPAN + 1, 3))
    assert len(short[2]) < 0.25 * len(long[2])


def test_a_splat_that_gets_far_is_not_stopped_though_few_are_judged() -> None:
    splats, stray = 4 * JUDGED, 1
    span = drifting(np.full(splats, SPAN + 1), 0.0, starts=True, tolerances=Tolerances(moves=Tolerance(1e-3, 1e-4, 0)))
    span.means[:, stray] += np.linspace(0, 4096 * STEP / MOVE_STEP, SPAN + 1, dtype=np.float32)[:, None]
    chunk = decoded(span)
    assert chunk.moves is not None
    off = (span.means - span.anchors) / STEP - chunk.moves / 64 / 2 ** chunk.finer[0]
    assert np.abs(off).max() <= STRAIGHT


def test_what_turns_as_one_comes_back_and_takes_fewer_bytes_in_the_order_of_a_tile_than_in_none() -> None:
    """Positions and rotations, from the tracks to the chunk and back."""
    random, count = np.random.default_rng(4), 1000
    places = random.uniform(-1, 1, (count, 3))
    places = places[morton_order(places.astype(np.float32))]
    angles = np.linspace(0, 1, SPAN + 1)
    turning = np.zeros((SPAN + 1, 3, 3))
    turning[:, 0, 0], turning[:, 1, 1], turning[:, 2, 2] = np.cos(angles), np.cos(angles), 1
    turning[:, 0, 1], turning[:, 1, 0] = -np.sin(angles), np.sin(angles)
    means = np.einsum("tij,nj->tni", turning, places).astype(np.float32)
    quats = np.zeros((SPAN + 1, count, 4), np.float32)
    quats[:, :, 0], quats[:, :, 3] = np.cos(angles / 2)[:, None], np.sin(angles / 2)[:, None]
    span = drifting(np.full(count, SPAN + 1), 0.0)
    span = replace(span, means=means, quats=quats, anchors=means[0], coarse=means[0], first=quats[0])
    chunk = decoded(span)
    assert chunk.moves is not None and chunk.turns is not None
    shown = evaluate(chunk, float(SPAN), Looks(span.anchors, span.first, np.zeros(count, np.float32)), span.steps)
    assert np.abs(shown.means - means[-1]).max() <= 3 * STEP
    assert np.abs(shown.quats - quats[-1]).max() <= 4 * STEP
    order = random.permutation(count)
    shuffled = replace(span, means=means[:, order], anchors=means[0, order], coarse=means[0, order])
    together, apart = (sum(map(len, encode_span(each).payloads)) for each in (span, shuffled))
    assert together < 0.8 * apart
