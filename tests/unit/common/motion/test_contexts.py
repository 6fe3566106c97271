"""Contexts depend on nothing that a decoder lacks: replaying the residuals gives the same tables and guesses."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cags_common.motion.contexts import CLASSES, REAL_TOLD, TOLD, Contexts, Row, class_tables, runs
from cags_common.motion.knots import END, Knot, knots, predicted
from cags_common.motion.neighbours import FIRST_FINER, FIRST_GROUPS, Neighbours, groups, relative
from support.anchors import scattered, together

UNIT = 8 << 6
FINER = UNIT // FIRST_FINER
"""Unit of the splat that is coded first."""


def contexts_of(splats: int, *, turn: bool) -> Contexts:
    anchors = scattered(splats)
    units = relative(anchors.turns if turn else anchors.moves)
    return Contexts(Neighbours.of(anchors, native=False), units, 4 if turn else 3, turn=turn)


def walked(residuals: np.ndarray, told: np.ndarray, *, turn: bool) -> tuple[list[tuple[object, ...]], np.ndarray]:
    """What was asked of the coder, and the residuals that came out."""
    span, splats, parts = len(residuals), *residuals.shape[1:]
    contexts, asked, out = contexts_of(splats, turn=turn), [], []
    samples = np.zeros((span + 1, splats, parts), np.int32)
    for knot in knots(span, start=False):
        given_now = residuals[knot.at - 1]

        def code(table, guess, unit, rows, part, given_now=given_now):  # type: ignore[no-untyped-def]
            asked.append((table.tolist(), guess.tolist(), rows.tolist(), part, unit))
            return given_now[rows, part]

        before = np.full((splats, parts), 100 * knot.at, np.int32)
        row = Row(predicted(samples, knot), before, told[knot.at - 1], UNIT)
        samples[knot.at], found = contexts.walk(knot, row, code)
        out.append(found)
    return asked, np.array(out)


@given(st.integers(1, 40), st.integers(0, 2**32 - 1), st.booleans())
@settings(max_examples=30)
def test_a_decoder_sees_the_same_contexts(splats: int, seed: int, turn: bool) -> None:
    random = np.random.default_rng(seed)
    residuals = random.integers(-70, 70, (4, splats, 4 if turn else 3)).astype(np.int32)
    told = random.random(residuals.shape) < 0.2
    asked, out = walked(residuals, told, turn=turn)
    order = [knot.at - 1 for knot in knots(4, start=False)]
    decoded = np.empty_like(residuals)
    decoded[order] = out
    assert np.array_equal(decoded, residuals), "each residual is coded once, in its place"
    assert walked(decoded, told, turn=turn)[0] == asked


def test_what_a_coarser_level_told_has_a_table_of_its_own_and_counts_for_nobody() -> None:
    residuals = np.full((1, 1, 3), 50, np.int32)
    told = np.array([[[True, False, False]]])
    first, second, third = (asked[0] for asked in walked(residuals, told, turn=False)[0] if asked[2])
    assert first == [TOLD]
    assert second == [int(class_tables()[1, 0])]
    assert third == [int(class_tables()[2, 150])]


def test_the_real_part_comes_last_and_has_tables_of_its_own() -> None:
    residuals, told = np.full((1, 1, 4), 1, np.int32), np.zeros((1, 1, 4), bool)
    asked = [ask for ask in walked(residuals, told, turn=True)[0] if ask[2]]
    assert [part for *_, part, _ in asked] == [1, 2, 3, 0]
    assert asked[-1][0] == [2], "of three imaginary parts of one unit each"
    told[0, 0, 0] = True
    assert [ask[0] for ask in walked(residuals, told, turn=True)[0] if ask[2]][-1] == [REAL_TOLD]


def one_knot(residuals: np.ndarray, line: int, before: int, told: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
    """Guesses of the first part by group, and samples, of splats of one size at one place."""
    splats, guesses = len(residuals), []
    anchors = together(splats)
    contexts = Contexts(Neighbours.of(anchors, native=False), anchors.moves, 3, turn=False)

    def code(table, guess, unit, rows, part):  # type: ignore[no-untyped-def]
        if part == 0:
            guesses.append(guess.copy())
        return residuals[rows, part]

    shape = residuals.shape
    row = Row(np.full(shape, line, np.int32), np.full(shape, before, np.int32), told, UNIT)
    samples, _ = contexts.walk(Knot(END, 1, 0, 0, -1), row, code)
    return guesses, samples


def test_neighbours_shift_what_the_line_leads_to_expect() -> None:
    residuals = np.zeros((5, 3), np.int32)
    residuals[0] = 3
    guesses, samples = one_knot(residuals, 70, 0, np.zeros((5, 3), bool))
    assert guesses[0].tolist() == [70]
    assert np.concatenate(guesses[1:]).tolist() == [70 + 3 * FINER] * 4
    assert (samples == 70 + 3 * FINER).all()


def test_what_was_told_before_is_not_guessed_again() -> None:
    residuals, told = np.zeros((5, 3), np.int32), np.zeros((5, 3), bool)
    residuals[0], told[1:, 0] = 3, True
    _, samples = one_knot(residuals, 70, 1000, told)
    assert samples[0].tolist() == [70 + 3 * FINER] * 3
    assert (samples[1:, 0] == 1000).all()
    assert (samples[4, 1:] == 70 + 3 * FINER).all(), "neither part is touched by another's"


def test_the_first_groups_are_told_in_finer_units() -> None:
    residuals, told = np.ones((1, 300, 3), np.int32), np.zeros((1, 300, 3), bool)
    units = [unit for *_, part, unit in walked(residuals, told, turn=False)[0] if part == 0]
    assert units == [FINER] * FIRST_GROUPS + [UNIT] * (len(groups(300)) - FIRST_GROUPS)
    alone = np.zeros((300, 3), np.int32)
    alone[128] = 1
    _, samples = one_knot(alone, 0, 0, np.ones((300, 3), bool))
    assert samples[128].tolist() == [FINER] * 3 and not np.delete(samples, 128, axis=0).any()


def test_classes_grow_with_the_expected_size() -> None:
    table = class_tables()
    assert table.max() == CLASSES - 1
    assert (np.diff(table[1:].astype(int), axis=1) >= 0).all()


@pytest.mark.parametrize("splats", [1, 2, 31, 32, 33, 100, 256, 257, 700])
def test_runs_cover_every_splat_of_every_part(splats: int) -> None:
    assert runs(splats, 3).sum() == 3 * splats
