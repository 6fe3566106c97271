"""The symbols of one level of a chunk, on their way into bytes and back: small numbers, and large ones beside them."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cags_kernels
from cags_common import rans
from cags_common.errors import DecodeError
from cags_common.geometry import F64
from cags_common.motion.contexts import CLASSES, U8, Contexts, class_tables, runs
from cags_common.motion.knots import FRACTION_BITS, I32, Knot, predicted, quantised

ESCAPE = 254
"""Signed numbers from here on, folded, stand beside the symbols in four bytes."""

LIFE, WIDTH, CENTRE, MOVE = 0, 1, 2, 3
TURN = MOVE + CLASSES
REAL = TURN + CLASSES
"""First tables of: lives, widths and centres of fades, positions, rotations, their real part; the latter by class."""


class SymbolWriter:
    """Collects the symbols of one level. ``native`` None takes the kernel where there is one, to the same bytes."""

    def __init__(self, *, native: bool | None = None) -> None:
        self._native = cags_kernels.native_available() if native is None else native
        self._tables: list[U8] = []
        self._symbols: list[U8] = []
        self._escapes: list[I32] = []
        self._runs: list[NDArray[np.int64]] = []

    def plain(self, table: int, values: U8) -> None:
        """Numbers [n] below 256."""
        self._add(np.full(len(values), table, np.uint8), values, len(values))

    def signed(self, tables: U8, values: NDArray[Any]) -> None:
        """Numbers [n] that fit 32 bits, of either sign, each by its table [n]."""
        wide = values.astype(np.int64)
        folded = np.where(wide < 0, -2 * wide - 1, 2 * wide)
        large = folded >= ESCAPE
        self._escapes.append(wide[large].astype(np.int32))
        self._add(tables, np.where(large, ESCAPE, folded).astype(np.uint8), len(values))

    def _add(self, tables: U8, symbols: U8, lengths: int | NDArray[np.int64]) -> None:
        self._tables.append(tables)
        self._symbols.append(symbols)
        self._runs.append(np.atleast_1d(np.asarray(lengths, np.int64)))

    def tree(self, order: tuple[Knot, ...], left: F64, unit: int, deadzone: float, *, turn: bool) -> None:
        """What is ``left`` [span + 1, n, c] to be said, in finest units, in units of ``unit``; takes it off there.

        A residual within half a unit and ``deadzone`` units is zero: a sample is off by no more than that.
        """
        splats, parts = left.shape[1:]
        if self._native:
            from cags_kernels import motion

            tables, symbols, escapes = motion.encode_tree(
                kernel_tree(order, left.shape, turn=turn), left, unit, deadzone
            )
            self._escapes.append(escapes)
            self._add(tables, symbols, np.tile(runs(splats, parts), len(order)))
            return
        contexts, samples = Contexts(splats, parts, turn=turn), np.zeros(left.shape, np.int32)
        for knot in order:
            guess = predicted(samples, knot)
            residual = quantised(left[knot.at] / unit, guess, deadzone)

            def code(tables: U8, flips: Any, rows: Any, part: int, residual: I32 = residual) -> I32:
                values: I32 = residual[rows, part]
                self.signed(
                    first_table(turn, part) + tables, values if flips is None else np.where(flips, -values, values)
                )
                return values

            contexts.walk(knot, code)
            samples[knot.at] = guess + (residual << FRACTION_BITS)
        left -= samples * (unit / (1 << FRACTION_BITS))

    def to_bytes(self) -> tuple[bytes, bytes]:
        """The large numbers, and the symbols."""
        escapes = np.concatenate([np.zeros(0, np.int32), *self._escapes]).astype("<i4").tobytes()
        nothing, none = np.zeros(0, np.uint8), np.zeros(0, np.int64)
        tables, symbols = np.concatenate([nothing, *self._tables]), np.concatenate([nothing, *self._symbols])
        return escapes, rans.encode(tables, symbols, np.concatenate([none, *self._runs]), native=self._native)


def first_table(turn: bool, part: int) -> np.uint8:
    """The table of class 0 of one part of a tree."""
    return np.uint8((REAL if part == 0 else TURN) if turn else MOVE)


def kernel_tree(order: tuple[Knot, ...], shape: tuple[int, ...], *, turn: bool) -> Any:
    """A tree as the kernel takes it."""
    from cags_kernels import motion

    span, splats, knots = shape[0] - 1, shape[1], _knot_rows(order)
    return motion.Tree(span, splats, turn, knots, class_tables(), TURN if turn else MOVE, REAL)


@cache
def _knot_rows(order: tuple[Knot, ...]) -> I32:
    rows = [(knot.kind, knot.at, knot.left, knot.right, knot.parent) for knot in order]
    return np.array(rows, np.int32).reshape(-1, 5)


class SymbolReader:
    """Reads the symbols of one level. Raises :class:`DecodeError` for damaged data."""

    def __init__(self, escapes: memoryview, symbols: memoryview, *, native: bool | None = None) -> None:
        if len(escapes) % 4:
            raise DecodeError("motion: large residuals are cut short")
        self._escapes, self._at = np.frombuffer(escapes, "<i4"), 0
        self._symbols = rans.decoder(symbols, native=native)

    def plain(self, table: int, count: int) -> U8:
        """The next ``count`` numbers, of one table."""
        return self._symbols.take(np.full(count, table, np.uint8))

    def signed(self, tables: U8) -> I32:
        """The next numbers [n], by the table of each."""
        folded = self._symbols.take(tables).astype(np.int32)
        values = np.where(folded & 1, -((folded + 1) >> 1), folded >> 1).astype(np.int32)
        large = np.flatnonzero(folded == ESCAPE)
        if len(large):
            if self._at + len(large) > len(self._escapes):
                raise DecodeError("motion: large residuals are missing")
            values[large] = self._escapes[self._at : self._at + len(large)]
            self._at += len(large)
        return values

    def tree(self, order: tuple[Knot, ...], shape: tuple[int, int, int], *, turn: bool) -> I32:
        """Samples [span + 1, n, c] of one level, in 1/64 of its unit."""
        if isinstance(self._symbols, rans.NativeDecoder):
            with rans.refused():
                kernel, tree = self._symbols.kernel, kernel_tree(order, shape, turn=turn)
                samples, self._at = kernel.tree(tree, self._escapes, self._at)
            return samples
        contexts, samples = Contexts(*shape[1:], turn=turn), np.zeros(shape, np.int32)

        def code(tables: U8, flips: Any, rows: Any, part: int) -> I32:
            values = self.signed(first_table(turn, part) + tables)
            return values if flips is None else np.where(flips, -values, values)

        for knot in order:
            residual = contexts.walk(knot, code)
            samples[knot.at] = predicted(samples, knot) + (residual << FRACTION_BITS)
        return samples

    def finish(self) -> None:
        """Check that everything was read."""
        self._symbols.finish()
        if self._at != len(self._escapes):
            raise DecodeError("motion: large residuals are left over")
