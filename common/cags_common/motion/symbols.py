"""The symbols of one level of a chunk, on their way into bytes and back: small numbers, and large ones beside them."""

from __future__ import annotations

import struct
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cags_kernels
from cags_common.coding import rans
from cags_common.coding.packing import squeeze, unsqueeze
from cags_common.errors import DecodeError
from cags_common.geometry import F64
from cags_common.motion.contexts import TOLD, U8, Contexts, class_tables, runs
from cags_common.motion.knots import FRACTION_BITS, I32, Knot, predicted, quantised

ESCAPE = 254
"""Signed numbers from here on, folded, stand beside the symbols in four bytes."""

MAX_ESCAPES = 1 << 23
"""More large numbers a level are none of ours."""

_ESCAPES = struct.Struct("<5I")
"""How many, and the bytes of each plane."""

LIFE_EDGES = np.array([2, 3, 5, 8])
"""Bounds of the kinds of lives that end within a span; one kind more are the others."""

LIFE, WIDTH = 0, 1
CENTRE = WIDTH + len(LIFE_EDGES) + 2
MOVE = CENTRE + 2
TURN = MOVE + TOLD + 1
REAL = TURN + TOLD + 1
"""First tables of: lives; widths of fades by kind of life; centres by whether it ends; positions, rotations and their
real part by class.
"""


def life_tables(splats: int) -> U8:
    """Tables [n] of lives."""
    return np.full(splats, LIFE, np.uint8)


def fade_tables(span: int, splats: int, lives: U8 | None) -> tuple[U8, U8]:
    """Tables [n] of the widths, and of the centres, of the fades of splats with these ``lives`` [n]."""
    ends = np.zeros(splats, bool) if lives is None else lives <= span
    kinds = np.zeros(splats, np.intp) if lives is None else np.searchsorted(LIFE_EDGES, lives, side="right")
    widths = WIDTH + np.where(ends, kinds, len(LIFE_EDGES) + 1)
    return widths.astype(np.uint8), (CENTRE + ends).astype(np.uint8)


class SymbolWriter:
    """Collects the symbols of one level. ``native`` None takes the kernel where there is one, to the same bytes."""

    def __init__(self, *, native: bool | None = None) -> None:
        self._native = cags_kernels.native_available() if native is None else native
        self._tables: list[U8] = []
        self._symbols: list[U8] = []
        self._escapes: list[I32] = []
        self._runs: list[NDArray[np.int64]] = []

    def plain(self, tables: U8, values: U8) -> None:
        """Numbers [n] below 256, each by its table [n]."""
        self._add(tables, values, len(values))

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

    def tree(self, order: tuple[Knot, ...], left: F64, told: U8, unit: int, deadzone: float, *, turn: bool) -> None:
        """What is ``left`` [span + 1, n, c] to be said, in finest units, in units of ``unit``; takes it off there.

        A residual within half a unit, and ``deadzone`` units where none was told before, is zero. ``told``
        [span + 1, n, c] is 1 where a coarser level had a residual, and becomes so where this one has.
        """
        splats, parts = left.shape[1:]
        if self._native:
            from cags_kernels import motion

            tables, symbols, escapes = motion.encode_tree(
                kernel_tree(order, left.shape, turn=turn), left, told, unit, deadzone
            )
            self._escapes.append(escapes)
            self._add(tables, symbols, np.tile(runs(splats, parts), len(order)))
            return
        contexts, samples = Contexts(splats, parts, turn=turn), np.zeros(left.shape, np.int32)
        for knot in order:
            apart = told[knot.at] != 0
            guess = np.where(apart, np.int32(0), predicted(samples, knot))
            residual = quantised(left[knot.at] / unit, guess, np.where(apart, 0.0, deadzone))

            def code(tables: U8, flips: Any, rows: Any, part: int, residual: I32 = residual) -> I32:
                values: I32 = residual[rows, part]
                self.signed(
                    first_table(turn, part) + tables, values if flips is None else np.where(flips, -values, values)
                )
                return values

            contexts.walk(knot, apart, code)
            samples[knot.at] = guess + (residual << FRACTION_BITS)
            told[knot.at] |= residual != 0
        left -= samples * (unit / (1 << FRACTION_BITS))

    def to_bytes(self) -> tuple[bytes, bytes]:
        """The large numbers, and the symbols."""
        escapes = _packed(np.concatenate([np.zeros(0, np.int32), *self._escapes]))
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
    rows = [(k.kind, k.at, k.left, k.right, k.parent, k.before, k.after, *k.weights) for k in order]
    return np.array(rows, np.int32).reshape(-1, 9)


def _packed(escapes: I32) -> bytes:
    """Large numbers [n]: how many, then folded, the four bytes of each as planes, every plane deflated by itself."""
    if not len(escapes):
        return b""
    wide = escapes.astype(np.int64)
    folded = np.where(wide < 0, -2 * wide - 1, 2 * wide).astype("<u4")
    planes = [squeeze(plane.tobytes()) for plane in folded.view(np.uint8).reshape(-1, 4).T]
    return _ESCAPES.pack(len(escapes), *map(len, planes)) + b"".join(planes)


def _unpacked(data: memoryview) -> I32:
    """Inverse of :func:`_packed`. Raises :class:`DecodeError`."""
    if not len(data):
        return np.zeros(0, np.int32)
    if len(data) < _ESCAPES.size:
        raise DecodeError("motion: large residuals are cut short")
    count, *sizes = _ESCAPES.unpack_from(data)
    if not 0 < count <= MAX_ESCAPES or sum(sizes) != len(data) - _ESCAPES.size:
        raise DecodeError(f"motion: {count} large residuals in {len(data)} bytes; beyond bounds, or cut short")
    folded, at = np.empty((count, 4), np.uint8), _ESCAPES.size
    for plane, size in enumerate(sizes):
        raw = unsqueeze(data[at : at + size], count, "motion: large residuals")
        folded[:, plane], at = np.frombuffer(raw, np.uint8), at + size
    whole = folded.view("<u4")[:, 0]
    return ((whole >> 1) ^ (np.uint32(0) - (whole & 1))).astype(np.uint32).view(np.int32)


class SymbolReader:
    """Reads the symbols of one level. Raises :class:`DecodeError` for damaged data."""

    def __init__(self, escapes: memoryview, symbols: memoryview, *, native: bool | None = None) -> None:
        self._escapes, self._at = _unpacked(escapes), 0
        self._symbols = rans.decoder(symbols, native=native)

    @property
    def read_bytes(self) -> int:
        """Bytes of symbols that were read; numpy's reader alone knows."""
        assert isinstance(self._symbols, rans.Decoder)
        return self._symbols.read_bytes

    def plain(self, tables: U8) -> U8:
        """The next numbers [n], by the table of each."""
        return self._symbols.take(tables)

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

    def tree(self, order: tuple[Knot, ...], told: U8, *, turn: bool) -> I32:
        """Samples [span + 1, n, c] of one level, in 1/64 of its unit. ``told`` [span + 1, n, c] is 1 where a coarser
        level had a residual, and becomes so where this one has.
        """
        shape = told.shape
        if isinstance(self._symbols, rans.NativeDecoder):
            with rans.refused():
                kernel, tree = self._symbols.kernel, kernel_tree(order, shape, turn=turn)
                samples, self._at = kernel.tree(tree, told, self._escapes, self._at)
            return samples
        contexts, samples = Contexts(*shape[1:], turn=turn), np.zeros(shape, np.int32)

        def code(tables: U8, flips: Any, rows: Any, part: int) -> I32:
            values = self.signed(first_table(turn, part) + tables)
            return values if flips is None else np.where(flips, -values, values)

        for knot in order:
            apart = told[knot.at] != 0
            residual = contexts.walk(knot, apart, code)
            samples[knot.at] = np.where(apart, np.int32(0), predicted(samples, knot)) + (residual << FRACTION_BITS)
            told[knot.at] |= residual != 0
        return samples

    def finish(self) -> None:
        """Check that everything was read."""
        self._symbols.finish()
        if self._at != len(self._escapes):
            raise DecodeError("motion: large residuals are left over")
