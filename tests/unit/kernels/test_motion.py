"""The kernels of motion check what they are given: sizes, indices and numbers that would lead out of the arrays."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import cags_kernels
from cags_common.coding import rans
from cags_common.motion.contexts import REAL_TOLD, TOLD, class_tables
from cags_common.motion.knots import knots
from cags_common.motion.neighbours import Neighbours
from cags_common.motion.symbols import MOVE, REAL, TURN, Samples, Tree
from support.anchors import scattered

pytestmark = pytest.mark.skipif(not cags_kernels.native_available(), reason="needs the native kernels")
SPAN, SPLATS = 4, 5


def tree(**changes: Any) -> Any:
    """Of units of 4; its arrays are as many as it says of splats there are."""
    anchors = scattered(SPLATS)
    tree = Tree.of(knots(SPAN, start=True), anchors, Neighbours.of(anchors), turn=False)
    whole = Samples.untold(tree, SPAN).kernel(4)
    count = max(changes.get("splats", SPLATS), 0)
    if count != SPLATS:
        near = np.zeros((count, 8), np.int32), np.zeros((count, 8, 8), np.float32), np.zeros(count, np.float32)
        changes |= dict(zip(("neighbours", "fits", "units"), near, strict=True))
    return replace(whole, **changes)


def order(**changes: int) -> np.ndarray:
    """The knots, of which the last is changed: kind, at, left, right, parent."""
    rows = tree().order.copy()
    for column, value in changes.items():
        rows[-1, ["kind", "at", "left", "right", "parent"].index(column)] = value
    return rows


def near(row: int, column: int, value: int) -> np.ndarray:
    """The neighbours, of which one is changed."""
    rows = tree().neighbours.copy()
    rows[row, column] = value
    return rows


WRONG = {
    "a span of nothing": {"span": 0},
    "a span beyond": {"span": 65},
    "splats beyond": {"splats": 1 << 17},
    "too many samples": {"span": 64, "splats": 60_000},
    "fewer splats than none": {"splats": -1},
    "more knots than samples": {"order": np.tile(order(), (2, 1))},
    "a knot beyond the span": {"order": order(at=SPAN + 1)},
    "a knot before the span": {"order": order(left=-1)},
    "a parent beyond": {"order": order(parent=SPAN + 1)},
    "an interval without a width": {"order": order(right=2, left=2, at=2)},
    "an unknown kind": {"order": order(kind=3)},
    "classes beyond": {"classes": np.full_like(class_tables(), 10)},
    "tables before the first": {"first_table": -1},
    "tables beyond": {"first_real_table": 60},
    "a neighbour beyond": {"neighbours": near(3, 2, SPLATS)},
    "a neighbour before": {"neighbours": near(0, 7, -1)},
    "a unit of nothing": {"unit": 0},
    "a unit below nothing": {"unit": -4},
    "a unit that is no power of two": {"unit": 3},
    "a unit beyond": {"unit": 1 << 21},
}


@pytest.mark.parametrize("changes", WRONG.values(), ids=WRONG.keys())
def test_a_tree_that_would_lead_out_of_its_arrays_is_refused(changes: dict[str, Any]) -> None:
    from cags_kernels import motion

    wrong = tree(**changes)
    empty = np.zeros(0, np.uint8)
    decoder = motion.SymbolDecoder(rans.encode(empty, empty, np.zeros(0, np.int64)))
    with pytest.raises((cags_kernels.KernelError, ValueError), match=r"out of range|negative"):
        decoder.tree(wrong, *blank(wrong.shape), np.zeros(0, np.int32), 0)
    with pytest.raises((cags_kernels.KernelError, ValueError), match=r"out of range|negative"):
        motion.encode_tree(wrong, np.zeros(wrong.shape), *blank(wrong.shape), 0.0)


def blank(shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Samples of which nothing is told."""
    return np.zeros(shape, np.int32), np.zeros(shape, np.uint8)


def test_arrays_of_another_kind_or_shape_are_refused() -> None:
    from cags_kernels import motion

    bytes_, one = np.zeros(4, np.uint8), np.ones((4, 256), np.uint32)
    with pytest.raises(ValueError, match="tables for"):
        motion.count_symbols(bytes_, bytes_[:2])
    with pytest.raises(ValueError, match="in one piece"):
        motion.count_symbols(bytes_[::2], bytes_[::2])
    with pytest.raises(cags_kernels.KernelError):
        motion.count_symbols(bytes_ + np.uint8(64), bytes_)
    with pytest.raises(cags_kernels.KernelError, match="out of range"):
        motion.encode_symbols(bytes_ + np.uint8(4), bytes_, np.array([4]), 1, (one, one))
    for runs, lanes in (([5], 1), ([-1, 5], 1), ([3], 1), ([4], 0), ([4], 33)):
        with pytest.raises((cags_kernels.KernelError, ValueError)):
            motion.encode_symbols(bytes_, bytes_, np.array(runs), lanes, (one, one))
    shape = (SPAN + 1, SPLATS, 3)
    wanted, (samples, told) = np.zeros(shape), blank(shape)
    decoder = motion.SymbolDecoder(rans.encode(bytes_[:0], bytes_[:0], np.zeros(0, np.int64)))
    for wrong in ((samples[1:], told), (samples, told[1:]), (samples.astype(np.int64), told), (samples, told == 0)):
        with pytest.raises(ValueError, match="expected"):
            motion.encode_tree(tree(), wanted, *wrong, 0.0)
        with pytest.raises(ValueError, match="expected"):
            decoder.tree(tree(), *wrong, np.zeros(0, np.int32), 0)
    with pytest.raises(ValueError, match="expected"):
        motion.encode_tree(tree(), wanted[1:], samples, told, 0.0)
    for changes in ({"neighbours": near(0, 0, 0)[1:]}, {"fits": tree().fits[:, 1:]}, {"units": tree().units[1:]}):
        with pytest.raises(ValueError, match="expected"):
            motion.encode_tree(tree(**changes), wanted, samples, told, 0.0)
    assert not samples.any() and not told.any()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_neighbours_of_what_is_not_finite_or_does_not_fit_are_refused(bad: float) -> None:
    from cags_kernels import motion

    looks = scattered(SPLATS)
    for column in (0, 1):
        given = [looks.positions.copy(), looks.moves.copy()]
        given[column].reshape(-1)[-1] = bad
        with pytest.raises(cags_kernels.KernelError, match="motion_neighbours"):
            motion.neighbours(*given)
    for wrong in ((looks.positions, looks.moves[1:]), (looks.positions[:, :2].copy(), looks.moves)):
        with pytest.raises(ValueError, match="expected"):
            motion.neighbours(*wrong)
    for wrong in ((looks.positions.astype(np.float64), looks.moves), (looks.positions[:, ::-1], looks.moves)):
        with pytest.raises(ValueError, match="in one piece"):
            motion.neighbours(*wrong)


def test_neighbours_of_no_splats_are_none_and_of_too_many_are_refused() -> None:
    from cags_kernels import motion

    rows, fits = motion.neighbours(np.zeros((0, 3), np.float32), np.zeros(0, np.float32))
    assert rows.shape == (0, 8) and fits.shape == (0, 8, 8)
    most = 1 << 16
    motion.neighbours(np.zeros((most, 3), np.float32), np.zeros(most, np.float32))
    with pytest.raises(cags_kernels.KernelError, match="motion_neighbours"):
        motion.neighbours(np.zeros((most + 1, 3), np.float32), np.zeros(most + 1, np.float32))


def motion_of(**changes: Any) -> Any:
    from cags_kernels.motion import TileMotion

    steps = np.ones(SPLATS, np.float32)
    still = TileMotion(
        *(SPLATS, SPAN, 1.0, 1, 0.0, np.arange(SPLATS, dtype=np.int32)), None, None, steps, steps, None, None
    )
    return replace(still, **changes)


def arrays(count: int) -> tuple[np.ndarray, ...]:
    return np.zeros((count, 3), np.float32), np.zeros((count, 4), np.float32), np.zeros(count, np.float32)


@pytest.mark.parametrize(
    "changes",
    [
        {"rows": np.full(SPLATS, 9, np.int32)},
        {"rows": np.full(SPLATS, -2, np.int32)},
        {"rows": np.zeros(SPLATS - 1, np.int32)},
        {"span": 65},
        {"splats": 1 << 17, "rows": np.zeros(1 << 17, np.int32)},
        {"sample": SPAN},
        {"sample": -1},
        {"time": float("nan")},
        {"share": 1.5},
        {"moves": np.zeros((SPAN, SPLATS, 3), np.int32)},
        {"turns": np.zeros((SPAN + 1, SPLATS, 3), np.int32)},
        {"move_steps": np.ones(SPLATS - 1, np.float32)},
        {"turn_steps": np.ones(SPLATS + 1, np.float32)},
        {"lives": np.zeros(SPLATS + 1, np.uint8)},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_a_tile_that_would_lead_out_of_the_arrays_is_refused_and_nothing_written(changes: dict[str, Any]) -> None:
    from cags_kernels import motion

    into = arrays(SPLATS)
    with pytest.raises((ValueError, cags_kernels.KernelError)):
        motion.move_rows([motion_of(), motion_of(**changes)], arrays(SPLATS), into, 1)
    with pytest.raises((ValueError, cags_kernels.KernelError)):
        motion.move_rows([motion_of()], arrays(SPLATS), into, 0)
    assert not any(array.any() for array in into)
    motion.move_rows([motion_of(turns=np.zeros((SPAN + 1, SPLATS, 4), np.int32))], arrays(SPLATS), into, 1)
    assert (into[1][:, 0] == 1).all()


def test_tables_of_the_definition_lie_within_what_is_allowed() -> None:
    assert MOVE + TOLD < TURN and TURN + TOLD < REAL
    assert class_tables().max() < TOLD
    assert REAL + REAL_TOLD < rans.MAX_TABLES
