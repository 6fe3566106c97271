"""The kernels of motion check what they are given: sizes, indices and numbers that would lead out of the arrays."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import cags_kernels
from cags_common.coding import rans
from cags_common.motion.contexts import class_tables
from cags_common.motion.knots import knots
from cags_common.motion.symbols import MOVE, REAL, kernel_tree

pytestmark = pytest.mark.skipif(not cags_kernels.native_available(), reason="needs the native kernels")
SPAN, SPLATS = 4, 5


def tree(**changes: Any) -> Any:
    return replace(kernel_tree(knots(SPAN, start=True), (SPAN + 1, SPLATS, 3), turn=False), **changes)


def order(**changes: int) -> np.ndarray:
    """The knots, of which the last is changed: kind, at, left, right, parent."""
    rows = tree().order.copy()
    for column, value in changes.items():
        rows[-1, ["kind", "at", "left", "right", "parent"].index(column)] = value
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
}


@pytest.mark.parametrize("changes", WRONG.values(), ids=WRONG.keys())
def test_a_tree_that_would_lead_out_of_its_arrays_is_refused(changes: dict[str, Any]) -> None:
    from cags_kernels import motion

    wrong = tree(**changes)
    empty = np.zeros(0, np.uint8)
    decoder = motion.SymbolDecoder(rans.encode(empty, empty, np.zeros(0, np.int64)))
    with pytest.raises((cags_kernels.KernelError, ValueError), match=r"out of range|negative"):
        decoder.tree(wrong, np.zeros(wrong.shape, np.uint8), np.zeros(0, np.int32), 0)
    with pytest.raises((cags_kernels.KernelError, ValueError), match=r"out of range|negative"):
        motion.encode_tree(wrong, np.zeros(wrong.shape), np.zeros(wrong.shape, np.uint8), 4, 0.0)


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
    apart = np.zeros((SPAN + 1, SPLATS, 3), np.uint8)
    with pytest.raises(ValueError):
        motion.encode_tree(tree(), np.zeros(apart.shape), apart[1:], 4, 0.0)
    with pytest.raises(ValueError, match="expected"):
        motion.encode_tree(tree(), np.zeros((SPAN, SPLATS, 3)), apart, 4, 0.0)
    with pytest.raises(cags_kernels.KernelError):
        motion.encode_tree(tree(), np.zeros((SPAN + 1, SPLATS, 3)), apart, 3, 0.0)


def motion_of(**changes: Any) -> Any:
    from cags_kernels.motion import TileMotion

    steps = np.ones(SPLATS, np.float32)
    still = TileMotion(
        *(SPLATS, SPAN, 1.0, 1, 0.0, np.arange(SPLATS, dtype=np.int32)), None, None, steps, steps, None, None, False
    )
    return replace(still, **changes)


def arrays(count: int) -> tuple[np.ndarray, ...]:
    return np.zeros((count, 3), np.float32), np.zeros((count, 4), np.float32), np.zeros(count, np.float32)


BLOCK = np.zeros((SPAN + 1, 3, 3), np.int32)


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
        {"blocks": (1, 1.0, BLOCK, BLOCK)},
        {"blocks": (-2, 1.0, BLOCK, BLOCK)},
        {"blocks": (1 << 30, 1.0, BLOCK[:, :1].copy(), BLOCK[:, :1].copy())},
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
    motion.move_rows([motion_of(blocks=(2, 1.0, BLOCK, BLOCK))], arrays(SPLATS), into, 1)
    assert (into[1][:, 0] == 1).all()


def test_tables_of_the_definition_lie_within_what_is_allowed() -> None:
    assert MOVE + class_tables().max() < REAL < rans.MAX_TABLES
