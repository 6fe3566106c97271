"""The C interface of motion: symbols to bytes and back, trees of residuals, tiles at a time. The GIL is released."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from cags_kernels.library import address, check, fields, library, native, sized

F32: TypeAlias = NDArray[np.float32]
F64: TypeAlias = NDArray[np.float64]
I32: TypeAlias = NDArray[np.int32]
U8: TypeAlias = NDArray[np.uint8]

MAX_TABLES = 64
_CLASSES = (8, 1324)
_NEIGHBOURS, _FIT = 8, 8
_Pointer, _int32, _int64, _double = ctypes.c_void_p, ctypes.c_int32, ctypes.c_int64, ctypes.c_double

_DAMAGE = {
    16: "end too early",
    17: "a table is asked for that they lack",
    18: "the data does not end where its symbols do",
    19: "header or tables are damaged",
    20: "large residuals are missing",
}


class DamagedError(ValueError):
    """Data that is not what an encoder wrote; the message says why, for a sentence that begins with what it is of."""


@native("CagsMotionTree")
class _Tree(ctypes.Structure):
    _fields_ = [
        *(
            (name, _int32)
            for name in (
                *("span", "splats", "parts", "turn", "knots"),
                *("first_table", "first_real_table", "silent_table", "unit"),
            )
        ),
        *((name, _Pointer) for name in ("order", "classes", "neighbours", "fits", "units")),
        ("lengths", _int64 * 4),
    ]


@native("CagsMotionTile")
class _Tile(ctypes.Structure):
    _fields_ = [
        *((name, _int32) for name in ("splats", "span", "sample")),
        *((name, _double) for name in ("time", "share")),
        *((name, _Pointer) for name in ("rows", "moves", "turns", "move_steps", "turn_steps", "lives", "fades")),
        ("lengths", _int64 * 7),
    ]


@native("CagsMotionArrays")
class _Arrays(ctypes.Structure):
    _fields_ = [
        ("capacity", _int64),
        *((name, _Pointer) for name in ("means", "quats", "logits", "into_means", "into_quats", "into_logits")),
        ("lengths", _int64 * 6),
    ]


@native("CagsSymbolsEncoding")
class _SymbolsEncoding(ctypes.Structure):
    _fields_ = [
        *(
            (name, _Pointer)
            for name in ("tables", "symbols", "run_lengths", "frequencies", "firsts", "states", "words")
        ),
        ("lengths", _int64 * 7),
    ]


@native("CagsTreeEncoding")
class _TreeEncoding(ctypes.Structure):
    _fields_ = [
        *((name, _Pointer) for name in ("wanted", "samples", "told", "tables", "symbols", "escapes")),
        *(("lengths", _int64 * 6), ("deadzone", _double)),
    ]


@dataclass(frozen=True, eq=False)
class Tree:
    """How the residuals of one level are laid out and coded; see ``cags_common.motion``."""

    span: int
    splats: int
    turn: bool
    unit: int
    """Finest units a unit of the residuals: a power of two."""
    order: I32  # [knots, 9] kind, at, left, right, parent, before, after, weights of these two
    classes: U8  # [8, 1324]
    first_table: int
    first_real_table: int
    silent_table: int
    """Of the flags whether a knot has no residuals."""
    neighbours: I32  # [splats, 8] of each, coded before it
    fits: F32  # [splats, 8, 8]
    units: F32  # [splats]

    @property
    def shape(self) -> tuple[int, int, int]:
        """Of the samples: [span + 1, splats, parts]."""
        return self.span + 1, self.splats, 4 if self.turn else 3

    @property
    def residuals(self) -> int:
        """How many of them say a tree, at most."""
        return len(self.order) * self.shape[1] * self.shape[2]

    def structure(self) -> _Tree:
        """What the library takes; valid while ``self`` lives."""
        if self.classes.shape != _CLASSES or self.order.shape[1:] != (9,):
            raise ValueError(f"classes of shape {self.classes.shape}, knots of {self.order.shape}")
        numbers = (self.span, self.splats, self.shape[2], int(self.turn), len(self.order))
        near = (self.splats, _NEIGHBOURS)
        order, classes = _typed(self.order, np.int32), _typed(self.classes, np.uint8)
        neighbours, fits = _fitting(self.neighbours, np.int32, near), _fitting(self.fits, np.float32, (*near, _FIT))
        arrays = classes, neighbours, fits, _fitting(self.units, np.float32, (self.splats,))
        tables = self.first_table, self.first_real_table, self.silent_table, self.unit
        return _Tree(*numbers, *tables, order.ctypes.data, *fields(*arrays))


def neighbours(positions: F32, units: F32) -> tuple[I32, F32]:
    """Rows [n, 8] and fits [n, 8, 8] of the neighbours of splats at ``positions`` [n, 3], of ``units`` [n].

    See ``cags_common.motion``. Raises ``KernelError`` for positions or units that are not finite.
    """
    near = (len(positions), _NEIGHBOURS)
    rows, fits = np.empty(near, np.int32), np.empty((*near, _FIT), np.float32)
    given = _fitting(positions, np.float32, (near[0], 3)), _fitting(units, np.float32, near[:1])
    arguments = (argument for array in (*given, rows, fits) for argument in sized(array))
    check(library().cags_motion_neighbours(*arguments), "motion_neighbours")
    return rows, fits


def count_symbols(tables: U8, symbols: U8) -> NDArray[np.int64]:
    """How often each table codes each symbol, [64, 256]. Raises ``KernelError`` for a table beyond."""
    counts = np.empty((MAX_TABLES, 256), np.int64)
    tables, symbols = _typed(tables, np.uint8), _typed(symbols, np.uint8)
    _check_same_length(tables, symbols)
    check(library().cags_symbols_count(*sized(tables), *sized(symbols), *sized(counts)), "symbols_count")
    return counts


def encode_symbols(
    tables: U8, symbols: U8, runs: NDArray[np.int64], lanes: int, shares: tuple[NDArray[np.uint32], NDArray[np.uint32]]
) -> tuple[NDArray[np.uint32], NDArray[np.uint16]]:
    """States [lanes] and words of the ``symbols``; ``shares``: frequencies and their sums before, [tables, 256]."""
    tables, symbols, runs = _typed(tables, np.uint8), _typed(symbols, np.uint8), _typed(runs, np.int64)
    frequencies, firsts = (_typed(array, np.uint32) for array in shares)
    _check_same_length(tables, symbols)
    states, words, written = np.empty(lanes, np.uint32), np.empty(len(symbols), np.uint16), _int64()
    arrays = (tables, symbols, runs, frequencies, firsts, states, words)
    given = _SymbolsEncoding(*fields(*arrays))
    check(library().cags_symbols_encode(ctypes.byref(given), ctypes.byref(written)), "symbols_encode")
    return states, words[len(words) - written.value :]


class SymbolDecoder:
    """Reads symbols. Raises :class:`DamagedError`. Not thread-safe."""

    def __init__(self, data: bytes | memoryview) -> None:
        self._data = np.frombuffer(data, np.uint8)
        call = library().cags_symbols_decoder_bytes
        call.restype = _int64
        self._state = np.empty(call() // 8, np.int64)
        decoder = address(self._state), _int64(self._state.nbytes)
        status = library().cags_symbols_open(*sized(self._data), *decoder)
        _check_data(status, "symbols_open")

    def take(self, tables: U8) -> U8:
        """The next symbols [n], by the table of each."""
        tables = _typed(tables, np.uint8)
        symbols = np.empty(len(tables), np.uint8)
        status = library().cags_symbols_take(address(self._state), *sized(tables), *sized(symbols))
        _check_data(status, "symbols_take")
        return symbols

    def tree(self, tree: Tree, samples: I32, told: U8, escapes: NDArray[Any], at: int) -> int:
        """The next of the ``escapes`` [n] after those from ``at`` on.

        ``samples`` and ``told`` [span + 1, splats, parts] are changed; see ``cags_common.motion``.
        """
        escapes, given, escape = _typed(escapes, np.int32), tree.structure(), _int64(at)
        both = _fitting(told, np.uint8, tree.shape), _fitting(samples, np.int32, tree.shape)
        status = library().cags_motion_decode_tree(
            *(ctypes.byref(given), address(self._state), *sized(escapes)),
            *(ctypes.byref(escape), *sized(both[0]), *sized(both[1])),
        )
        _check_data(status, "motion_decode_tree")
        return escape.value

    def finish(self) -> None:
        """Check that everything was read."""
        _check_data(library().cags_symbols_finish(address(self._state)), "symbols_finish")


def encode_tree(tree: Tree, wanted: F64, samples: I32, told: U8, deadzone: float) -> tuple[U8, U8, I32]:
    """Tables and symbols [n] and large residuals that take ``samples`` closer to those ``wanted``, within 2**26 units.

    All are [span + 1, splats, parts]; ``samples`` and ``told`` are changed; see ``cags_common.motion``.
    """
    tables, symbols = (np.empty(len(tree.order) + tree.residuals, np.uint8) for _ in range(2))
    escapes, written, given = np.empty(tree.residuals, np.int32), (_int64 * 2)(), tree.structure()
    columns = ((wanted, np.float64), (samples, np.int32), (told, np.uint8))
    arrays = (*(_fitting(array, dtype, tree.shape) for array, dtype in columns), tables, symbols, escapes)
    encoding = _TreeEncoding(*fields(*arrays), deadzone)
    call = library().cags_motion_encode_tree
    check(call(ctypes.byref(given), ctypes.byref(encoding), written), "motion_encode_tree")
    return tables[: written[0]].copy(), symbols[: written[0]].copy(), escapes[: written[1]].copy()


@dataclass(frozen=True, slots=True, eq=False)
class TileMotion:
    """One tile at a time; arrays are C-contiguous, None leaves that part of the motion out."""

    splats: int
    span: int
    time: float
    """Frames from the first of the span, which it is within."""
    sample: int
    share: float
    """Of the way from ``sample`` to the next."""
    rows: I32  # [splats] of the arrays by id; -1: left out
    moves: I32 | None  # [span + 1, splats, 3]
    turns: I32 | None  # [span + 1, splats, 4]
    move_steps: F32  # [splats]
    turn_steps: F32  # [splats]
    lives: U8 | None  # [splats]
    fades: F32 | None  # [splats, 2]

    def structure(self) -> _Tile:
        """What the library takes; valid while ``self`` lives. Raises ``ValueError`` for arrays that do not fit."""
        n, samples = self.splats, self.span + 1
        arrays = (
            _fitting(self.rows, np.int32, (n,)),
            _fitting(self.moves, np.int32, (samples, n, 3)),
            _fitting(self.turns, np.int32, (samples, n, 4)),
            _fitting(self.move_steps, np.float32, (n,)),
            _fitting(self.turn_steps, np.float32, (n,)),
            _fitting(self.lives, np.uint8, (n,)),
            _fitting(self.fades, np.float32, (n, 2)),
        )
        return _Tile(n, self.span, self.sample, self.time, self.share, *fields(*arrays))


def move_rows(
    tiles: Sequence[TileMotion], looks: tuple[F32, F32, F32], into: tuple[F32, F32, F32], threads: int
) -> None:
    """Evaluate ``tiles`` from rows of ``looks`` to the same rows of ``into``: means, quaternions, opacity logits by id.

    Raises ``ValueError`` for arrays that do not fit and ``KernelError`` for rows beyond them; nothing is written then.
    """
    capacity = len(looks[0])
    shapes = ((capacity, 3), (capacity, 4), (capacity,))
    columns = [_fitting(a, np.float32, s) for arrays in (looks, into) for a, s in zip(arrays, shapes, strict=True)]
    given = (_Tile * len(tiles))(*(tile.structure() for tile in tiles))
    arrays = _Arrays(capacity, *fields(*columns))
    status = library().cags_motion_rows(given, _int32(len(tiles)), ctypes.byref(arrays), _int32(threads))
    check(status, "motion_rows")


def _check_data(status: int, call: str) -> None:
    if status in _DAMAGE:
        raise DamagedError(_DAMAGE[status])
    check(status, call)


def _check_same_length(tables: U8, symbols: U8) -> None:
    if tables.shape != symbols.shape or tables.ndim != 1:
        raise ValueError(f"{tables.shape} tables for {symbols.shape} symbols")


def _typed(array: NDArray[Any], dtype: type[np.generic]) -> NDArray[Any]:
    if array.dtype != dtype or not array.flags.c_contiguous:
        raise ValueError(f"array of {array.dtype}, expected {np.dtype(dtype)} in one piece")
    return array


_Array = TypeVar("_Array", bound=NDArray[Any] | None)


def _fitting(array: _Array, dtype: type[np.generic], shape: tuple[int, ...]) -> _Array:
    if array is not None and _typed(array, dtype).shape != shape:
        raise ValueError(f"array of shape {array.shape}, expected {shape}")
    return array
