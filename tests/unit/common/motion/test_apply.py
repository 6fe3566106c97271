"""Tiles at a time: positions, rotations, lives and fades, and rows that are somebody else's left alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import cags_kernels
from cags_common.motion.apply import ABSENT_LOGIT, Looks, MovingTile, Steps, evaluate, move_rows
from cags_common.motion.chunk import Chunk

SPAN, SPLATS = 4, 3
KERNELS = [False, True] if cags_kernels.native_available() else [False]


def looks_of(count: int = SPLATS) -> Looks:
    random = np.random.default_rng(1)
    quats = random.normal(size=(count, 4))
    quats *= np.sign(quats[:, :1]) / np.linalg.norm(quats, axis=1, keepdims=True)
    means, logits = random.normal(size=(count, 3)), random.normal(size=count)
    return Looks(*(np.ascontiguousarray(array, dtype=np.float32) for array in (means, quats, logits)))


def still(**parts: object) -> Chunk:
    return replace(Chunk((0, 0), SPAN, SPLATS, None, None, None, None, True), **parts)  # type: ignore[arg-type]


STEPS = Steps(np.full(SPLATS, 0.5, np.float32), np.full(SPLATS, 0.25, np.float32))


def test_a_chunk_that_says_nothing_changes_nothing() -> None:
    looks = looks_of()
    moved = evaluate(still(), 1.5, looks, STEPS)
    assert np.array_equal(moved.means, looks.means) and np.array_equal(moved.quats, looks.quats)
    assert np.array_equal(moved.logit_opacities, looks.logit_opacities)


def test_positions_follow_the_line_between_frames_and_stay_at_the_end() -> None:
    moves = np.zeros((SPAN + 1, SPLATS, 3), np.int32)
    moves[:, :, 0] = 64 * 2 * np.arange(SPAN + 1)[:, None]
    looks = looks_of()
    for time, way in ((-1.0, 0.0), (0.0, 0.0), (0.25, 0.25), (2.0, 2.0), (3.75, 3.75), (4.0, 4.0), (99.0, 4.0)):
        at = evaluate(still(moves=moves), time, looks, STEPS).means
        assert np.allclose(at[:, 0], looks.means[:, 0] + way, atol=1e-6)
        assert np.array_equal(at[:, 1:], looks.means[:, 1:])


def test_a_rotation_through_half_a_turn_and_beyond_keeps_its_way() -> None:
    angles = np.linspace(0, 2 * np.pi, SPAN + 1)
    residual = np.zeros((SPAN + 1, SPLATS, 4))
    residual[:, :, 0], residual[:, :, 3] = (np.cos(angles / 2) - 1)[:, None], np.sin(angles / 2)[:, None]
    chunk = still(turns=np.rint(residual * 64 / 0.25).astype(np.int32))
    looks = replace(looks_of(), quats=np.tile(np.float32([1, 0, 0, 0]), (SPLATS, 1)))
    for time in range(SPAN + 1):
        quats = evaluate(chunk, time, looks, STEPS).quats
        wanted = np.array([np.cos(angles[time] / 2), 0, 0, np.sin(angles[time] / 2)])
        assert np.allclose(np.abs(quats @ wanted), 1, atol=1e-4)
        assert (quats[:, 0] >= 0).all() and np.allclose(np.linalg.norm(quats, axis=1), 1, atol=1e-6)


def test_a_life_ends_when_its_last_frame_has_passed_and_none_does_at_the_spans_end() -> None:
    chunk = still(lives=np.array([0, 1, SPAN + 1], np.uint8))
    there = [evaluate(chunk, time, looks_of(), STEPS).logit_opacities != ABSENT_LOGIT for time in (0.0, 0.9, 1.0, 4.0)]
    assert np.array_equal(there, [[0, 1, 1], [0, 1, 1], [0, 0, 1], [0, 0, 1]])


def test_a_splat_that_has_ended_stands_where_it_was_then() -> None:
    random = np.random.default_rng(3)
    chunk = still(
        moves=random.integers(-99, 99, (SPAN + 1, SPLATS, 3)).astype(np.int32),
        turns=random.integers(-99, 99, (SPAN + 1, SPLATS, 4)).astype(np.int32),
    )
    ending = replace(chunk, lives=np.array([0, 2, SPAN], np.uint8))
    for native in KERNELS:
        rows, into = np.arange(SPLATS, dtype=np.int32), into_of(SPLATS)
        move_rows([MovingTile(ending, SPAN, rows, STEPS)], looks_of(), into, native=native)
        for splat, end in enumerate(ending.lives.tolist()):
            then = evaluate(chunk, end, looks_of(), STEPS)
            assert np.array_equal(into.means[splat], then.means[splat])
            assert np.array_equal(into.quats[splat], then.quats[splat])


def test_a_fade_is_full_at_its_centre_and_a_gaussian_beside_it() -> None:
    fades = np.array([[2, 1], [2, np.inf], [0, 1]], np.float32)
    looks = replace(looks_of(), logit_opacities=np.zeros(SPLATS, np.float32))
    logits = evaluate(still(fades=fades), 2.0, looks, STEPS).logit_opacities.astype(float)
    assert np.allclose(1 / (1 + np.exp(-logits)), [0.5, 0.5, 0.5 * np.exp(-2)], atol=1e-6)


def test_a_fade_of_a_splat_that_nobody_can_see_overflows_nothing() -> None:
    looks = replace(looks_of(), logit_opacities=np.full(SPLATS, -3e38, np.float32))
    fades = np.array([[1e12, 0.125]] * SPLATS, np.float32)
    assert np.isfinite(evaluate(still(fades=fades), 0.0, looks, STEPS).logit_opacities).all()


def test_time_must_be_a_number() -> None:
    with pytest.raises(ValueError, match="not a number"):
        evaluate(still(), float("nan"), looks_of(), STEPS)


def into_of(count: int) -> Looks:
    return Looks(np.full((count, 3), 9, np.float32), np.full((count, 4), 9, np.float32), np.full(count, 9, np.float32))


def test_rows_are_read_and_written_by_id_and_others_left_alone() -> None:
    random = np.random.default_rng(2)
    chunk = still(
        moves=random.integers(-99, 99, (SPAN + 1, SPLATS, 3)).astype(np.int32),
        turns=random.integers(-99, 99, (SPAN + 1, SPLATS, 4)).astype(np.int32),
        lives=np.array([5, 1, 5], np.uint8),
    )
    looks, into, rows = looks_of(9), into_of(9), np.array([6, -1, 2], np.int32)
    move_rows([MovingTile(chunk, 2.25, rows, STEPS)], looks, into)
    wanted = evaluate(chunk, 2.25, looks.take(np.maximum(rows, 0)), STEPS)
    for name in ("means", "quats", "logit_opacities"):
        assert np.array_equal(getattr(into, name)[[6, 2]], getattr(wanted, name)[[0, 2]])
        assert (np.delete(getattr(into, name), [6, 2], axis=0) == 9).all()


@pytest.mark.parametrize(
    ("rows", "time"), [([0, 1, 9], 0.0), ([0, 1, -2], 0.0), ([0, 1], 0.0), ([0, 1, 2], float("nan"))]
)
def test_what_does_not_fit_is_refused_and_nothing_written(rows: list[int], time: float) -> None:
    good = MovingTile(still(), 0.0, np.arange(SPLATS, dtype=np.int32), STEPS)
    bad, into = MovingTile(still(), time, np.array(rows, np.int32), STEPS), into_of(9)
    with pytest.raises(ValueError, match="motion"):
        move_rows([good, bad], looks_of(9), into)
    assert (into.means == 9).all()


def mixed(count: int, seed: int) -> Chunk:
    """Splats that move, turn, stand elsewhere, fade, end, or stand still; for odd seeds all do the former."""
    random = np.random.default_rng(seed)
    kinds = random.choice(6, count, p=[0.6, *[0.08] * 5] if seed % 2 == 0 else [0, *[0.2] * 5])
    moves, turns = (random.integers(-99, 99, (SPAN + 1, count, width)).astype(np.int32) for width in (3, 4))
    for part, moving in ((moves, 1), (turns, 2)):
        part[:, (kinds != moving) & (kinds != 3)] = 0
        part[:, kinds == 3] = part[0, kinds == 3]
    fades = np.where(kinds[:, None] == 4, [2, 1], [0, np.inf]).astype(np.float32)
    lives = np.where(kinds == 5, random.integers(SPAN, size=count), SPAN + 1).astype(np.uint8)
    parts = {"splats": count, "moves": moves, "turns": turns, "fades": fades, "lives": lives}
    return still(**parts)


@pytest.mark.parametrize("native", KERNELS)
@pytest.mark.parametrize("seed", range(4))
def test_only_what_is_in_motion_is_evaluated_again_and_all_bits_are_those_of_a_whole_evaluation(
    seed: int, native: bool
) -> None:
    count = 45
    chunk, looks = mixed(count, seed), looks_of(count)
    steps = Steps(np.full(count, 0.5, np.float32), np.full(count, 0.25, np.float32))
    rows = np.random.default_rng(seed).permutation(count).astype(np.int32)
    rows[::9] = -1
    tile, into, since = MovingTile(chunk, 0.0, rows, steps), into_of(count), 0.0
    move_rows([tile], looks, into, native=native)
    for time in (0.5, 1.0, 1.25, 2.0, 3.75, 3.0, 4.0, 9.0, 0.25):
        tile.time, whole, before = time, into_of(count), into.means.copy()
        part = tile.in_motion(since)
        ended = part.chunk.lives <= min(since, time, SPAN)
        assert (part.rows[ended] == -1).all(), "what had ended before is left out"
        since = time
        move_rows([part], looks, into, native=native)
        move_rows([MovingTile(chunk, time, rows, steps)], looks, whole, native=native)
        for name in ("means", "quats", "logit_opacities"):
            assert np.array_equal(getattr(into, name), getattr(whole, name)), (time, name)
        told = np.zeros(count, bool)
        told[part.rows[part.rows >= 0]] = True
        assert not (into.means != before).any(axis=1)[~told].any()
    assert 0 < told.sum() < (0.875 if seed % 2 == 0 else 1) * (rows >= 0).sum(), "some are left out"


def test_what_has_ended_at_the_first_frame_is_evaluated_again_where_its_opacity_was_updated() -> None:
    chunk = still(lives=np.array([0, 2, SPAN + 1], np.uint8))
    tile = MovingTile(chunk, 1.0, np.arange(SPLATS, dtype=np.int32), STEPS)
    assert tile.in_motion(0.0).rows.tolist() == [-1, 1]
    assert tile.in_motion(None).rows.tolist() == [0, 1]


def test_of_a_tile_in_which_everything_moves_the_part_in_motion_is_the_tile() -> None:
    moves = np.arange((SPAN + 1) * SPLATS * 3, dtype=np.int32).reshape(SPAN + 1, SPLATS, 3)
    tile = MovingTile(still(moves=moves), 0.0, np.arange(SPLATS, dtype=np.int32), STEPS)
    assert tile.in_motion(0.0) is tile


def test_tiles_of_one_chunk_share_its_part_in_motion() -> None:
    """A server has a mirror a client: what they all read is there once."""
    chunk, rows = mixed(45, 1), np.arange(45, dtype=np.int32)
    steps = Steps(np.ones(45, np.float32), np.ones(45, np.float32))
    one, other = (MovingTile(chunk, 0.0, rows, steps).in_motion(0.0).chunk for _ in range(2))
    assert one is other is not chunk


def test_nothing_of_a_tile_that_stands_is_in_motion() -> None:
    tile = MovingTile(
        still(moves=np.full((SPAN + 1, SPLATS, 3), 8, np.int32)), 1.0, np.arange(3, dtype=np.int32), STEPS
    )
    assert len(tile.in_motion(0.0).rows) == 0
    move_rows([tile.in_motion(0.0)], looks_of(), into := into_of(SPLATS))
    assert (into.means == 9).all()
