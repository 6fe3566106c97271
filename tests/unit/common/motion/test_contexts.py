"""Contexts depend on nothing that a decoder lacks: replaying the residuals gives the same tables and signs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cags_common.motion.contexts import CLASSES, TOLD, Contexts, class_tables, runs
from cags_common.motion.knots import knots


def walked(residuals: np.ndarray, told: np.ndarray, *, turn: bool) -> tuple[list[tuple[object, ...]], np.ndarray]:
    """What was asked of the coder, and the residuals that came out."""
    span, splats, parts = len(residuals), *residuals.shape[1:]
    contexts, asked, out = Contexts(splats, parts, turn=turn), [], []
    for knot in knots(span, start=False):
        given_now = residuals[knot.at - 1]

        def code(table, flips, rows, part, given_now=given_now):  # type: ignore[no-untyped-def]
            asked.append((table.tolist(), None if flips is None else flips.tolist(), rows.tolist(), part))
            return given_now[rows, part]

        out.append(contexts.walk(knot, told[knot.at - 1], code))
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


def test_classes_grow_with_the_expected_size() -> None:
    table = class_tables()
    assert table.max() == CLASSES - 1
    assert (np.diff(table[1:].astype(int), axis=1) >= 0).all()


@pytest.mark.parametrize("splats", [1, 2, 31, 32, 33, 100])
def test_runs_cover_every_splat_of_every_part(splats: int) -> None:
    assert runs(splats, 3).sum() == 3 * splats
