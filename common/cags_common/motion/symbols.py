"""The symbols of one level of a chunk, on their way into bytes and back: small numbers, and large ones beside them."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cags_kernels
from cags_common.coding import rans
from cags_common.coding.packing import squeeze, unsqueeze
from cags_common.errors import DecodeError
from cags_common.geometry import F32, F64
from cags_common.motion.contexts import TOLD, U8, Code, Contexts, Row, class_tables, runs
from cags_common.motion.knots import FRACTION_BITS, I32, Knot, predicted, quantised
from cags_common.motion.neighbours import Anchors, Neighbours, relative

ESCAPE = 254
"""Signed numbers from here on, folded, stand beside the symbols in four bytes."""

MAX_ESCAPES = 1 << 23
"""More large numbers a level are none of ours."""

_ESCAPES = struct.Struct("<5I")
"""How many, and the bytes of each plane."""

LIFE_EDGES = np.array([2, 3, 5, 8])
"""Bounds of the kinds of lives that end within a span; one kind more are the others."""

LIFE, SILENT, WIDTH = 0, 1, 2
CENTRE = WIDTH + len(LIFE_EDGES) + 2
MOVE = CENTRE + 2
TURN = MOVE + TOLD + 1
REAL = TURN + TOLD + 1
"""First tables of: lives; flags whether a knot has no residuals; widths of fades by kind of life; centres by whether it
ends; positions, rotations and their real part by class.
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


@dataclass(frozen=True, slots=True, eq=False)
class Tree:
    """How the positions or rotations of a chunk are told."""

    order: tuple[Knot, ...]
    near: Neighbours
    units: F32  # [n] in parts of the largest
    turn: bool
    """Whether they are rotations, whose part 0 is real."""

    @staticmethod
    def of(order: tuple[Knot, ...], anchors: Anchors, near: Neighbours, *, turn: bool) -> Tree:
        """That of the splats of ``anchors``, whose neighbours are ``near``."""
        return Tree(order, near, relative(anchors.turns if turn else anchors.moves), turn)


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Positions or rotations of the splats that move, as far as told; every level changes them."""

    tree: Tree
    values: I32  # [span + 1, n, c] in 1/64 of the finest unit
    told: U8  # [span + 1, n, c] 1 where a level had a residual

    @staticmethod
    def untold(tree: Tree, span: int) -> Samples:
        """Those of ``span`` frames after the first, of which nothing is told yet."""
        shape = span + 1, len(tree.units), 4 if tree.turn else 3
        return Samples(tree, np.zeros(shape, np.int32), np.zeros(shape, np.uint8))

    def copy(self) -> Samples:
        """One that changes apart."""
        return Samples(self.tree, self.values.copy(), self.told.copy())

    def walk(self, unit: int, coded: Callable[[Knot, Row], Code]) -> Iterator[I32]:
        """Take the samples on by a level of units of ``unit``, by the residuals that ``coded`` codes for each knot.

        Yields these residuals [n, c], knot by knot.
        """
        tree = self.tree
        contexts = Contexts(tree.near, tree.units, self.values.shape[2], turn=tree.turn)
        for knot in tree.order:
            before, told = self.values[knot.at].copy(), self.told[knot.at] != 0
            row = Row(predicted(self.values, knot), before, told, unit << FRACTION_BITS)
            self.values[knot.at], residuals = contexts.walk(knot, row, coded(knot, row))
            self.told[knot.at] |= residuals != 0
            yield residuals

    def kernel(self, unit: int) -> Any:
        """A level of units of ``unit``, as the kernel takes it."""
        from cags_kernels import motion

        tree, (samples, splats, _) = self.tree, self.values.shape
        first = TURN if tree.turn else MOVE
        knots, near = _knot_rows(tree.order), tree.near
        numbers = samples - 1, splats, tree.turn, unit
        tables = first, REAL, SILENT
        return motion.Tree(*numbers, knots, class_tables(), *tables, near.rows, near.fits, tree.units)


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

    def tree(self, part: Samples, wanted: F64, unit: int, deadzone: float) -> None:
        """Take the values of ``part`` closer to those ``wanted``, in finest units, by residuals in units of ``unit``.

        A residual within half a unit, and ``deadzone`` units where none was told before, is zero.
        """
        if self._native:
            from cags_kernels import motion

            tables, symbols, escapes = motion.encode_tree(part.kernel(unit), wanted, part.values, part.told, deadzone)
            self._escapes.append(escapes)
            self._add(tables, symbols, _runs_of(tables, runs(*part.values.shape[1:])))
            return

        def told_by(wanted: F64, zone: F64) -> Code:
            def code(tables: U8, guess: I32, fixed: int, rows: NDArray[np.intp], at: int) -> I32:
                goal = wanted[rows, at] * ((1 << FRACTION_BITS) / fixed)
                values = quantised(goal, guess / fixed, zone[rows, at])
                self.signed(first_table(part.tree.turn, at) + tables, values)
                return values

            return code

        def coded(knot: Knot, row: Row) -> Code:
            self.plain(np.full(1, SILENT, np.uint8), silent := np.zeros(1, np.uint8))
            begun.append((silent, len(self._symbols)))
            return told_by(wanted[knot.at], np.where(row.told, 0.0, deadzone))

        begun: list[tuple[U8, int]] = []
        for residuals in part.walk(unit, coded):
            silent, first = begun.pop()
            if not residuals.any():
                silent[0] = 1
                for column in (self._tables, self._symbols, self._runs):
                    del column[first:]

    def to_bytes(self) -> tuple[bytes, bytes]:
        """The large numbers, and the symbols."""
        escapes = _packed(np.concatenate([np.zeros(0, np.int32), *self._escapes]))
        nothing, none = np.zeros(0, np.uint8), np.zeros(0, np.int64)
        tables, symbols = np.concatenate([nothing, *self._tables]), np.concatenate([nothing, *self._symbols])
        return escapes, rans.encode(tables, symbols, np.concatenate([none, *self._runs]), native=self._native)


def first_table(turn: bool, part: int) -> np.uint8:
    """The table of class 0 of one part of a tree."""
    return np.uint8((REAL if part == 0 else TURN) if turn else MOVE)


def _runs_of(tables: U8, of_knot: NDArray[np.int64]) -> NDArray[np.int64]:
    """Runs of the symbols of a tree with these ``tables`` [n]; ``of_knot`` are those of a knot that has residuals."""
    out, flags = [np.zeros(0, np.int64)], np.flatnonzero(tables == SILENT)
    for symbols in np.diff(flags, append=len(tables)):
        out += [np.ones(1, np.int64), of_knot[: len(of_knot) if symbols > 1 else 0]]
    return np.concatenate(out)


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

    def tree(self, part: Samples, unit: int) -> None:
        """Take ``part`` on by one level, of units of ``unit``."""
        if isinstance(self._symbols, rans.NativeDecoder):
            with rans.refused():
                tree, kernel = part.kernel(unit), self._symbols.kernel
                self._at = kernel.tree(tree, part.values, part.told, self._escapes, self._at)
            return

        def code(tables: U8, guess: I32, fixed: int, rows: NDArray[np.intp], at: int) -> I32:
            del guess, fixed, rows
            return self.signed(first_table(part.tree.turn, at) + tables)

        def nothing(tables: U8, *told: Any) -> I32:
            del told
            return np.zeros(len(tables), np.int32)

        def coded(knot: Knot, row: Row) -> Code:
            del knot, row
            return nothing if self.plain(np.full(1, SILENT, np.uint8))[0] else code

        for _ in part.walk(unit, coded):
            pass

    def finish(self) -> None:
        """Check that everything was read."""
        self._symbols.finish()
        if self._at != len(self._escapes):
            raise DecodeError("motion: large residuals are left over")
