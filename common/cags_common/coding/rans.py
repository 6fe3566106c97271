"""Range asymmetric numeral systems (Duda 2013): entropy coding of small symbols by static tables.

Several lanes, each a coder of its own, share one stream of 16-bit words (Giesen 2014): numpy then works on a row of
lanes at once, and a kernel keeps its pipeline full. Tables travel with the data
(:mod:`.tables`); which table a symbol uses may depend
on symbols of earlier calls. The definition is here; the native kernel gives the same symbols and the same bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cags_kernels
from cags_common.coding.tables import MAX_SYMBOLS, PROBABILITY_BITS, TOTAL, Table, Tables, read_tables
from cags_common.errors import DecodeError

U8 = NDArray[np.uint8]
U16 = NDArray[np.uint16]

MAX_LANES = 32
SYMBOLS_A_LANE = 4096
"""A lane costs four bytes; so many symbols pay for it."""

MAX_TABLES = 64
_LOW = 1 << 16
_HEAD = struct.Struct("<BBI")  # lanes, tables, words


def _shares(tables: Sequence[Table]) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Frequencies of every table's symbols, and the sums of those before each: [tables, 256]."""
    frequencies, firsts = (np.zeros((len(tables), 256), np.uint32) for _ in range(2))
    for i, table in enumerate(tables):
        count = len(table.frequencies)
        frequencies[i, :count] = table.frequencies
        firsts[i, 1:count] = np.cumsum(table.frequencies)[:-1]
    return frequencies, firsts


def encode(tables: U8, symbols: U8, runs: NDArray[np.int64], *, native: bool | None = None) -> bytes:
    """The ``symbols`` [n], each by its table [n], to be read in ``runs`` that add up to n. Same input, same bytes.

    Tables are numbered from 0; they are made from what occurs, and similar ones in a row are merged. ``native`` None
    takes the kernel where there is one. Raises ``ValueError`` for more than ``MAX_TABLES`` or symbols from
    ``MAX_SYMBOLS`` on.
    """
    native = cags_kernels.native_available() if native is None else native
    count = 1 + int(tables.max(initial=0))
    if count > MAX_TABLES:
        raise ValueError(f"symbols: table {count - 1} is asked for, the last one is {MAX_TABLES - 1}")
    if len(tables) != len(symbols) or int(runs.sum()) != len(symbols) or int(runs.min(initial=0)) < 0:
        raise ValueError(f"symbols: {len(symbols)} of them have {len(tables)} tables and runs of {int(runs.sum())}")
    if int(symbols.max(initial=0)) >= MAX_SYMBOLS:
        raise ValueError(f"symbols: {int(symbols.max())} is none; the last one is {MAX_SYMBOLS - 1}")
    told = Tables.of(_counted(tables, symbols, native=native)[:count])
    made = told.each
    lanes = min(max(len(symbols) // SYMBOLS_A_LANE, 1), MAX_LANES)
    if native:
        from cags_kernels import motion

        states, words = motion.encode_symbols(tables, symbols, runs, lanes, _shares(made))
    else:
        states, words = _encoded(made, tables, symbols, runs, lanes)
    head = _HEAD.pack(lanes, count, len(words))
    tail = states.astype("<u4").tobytes() + words.astype("<u2", copy=False).tobytes()
    return head + told.to_bytes() + tail


def _counted(tables: U8, symbols: U8, *, native: bool) -> NDArray[np.int64]:
    """How often each table codes each symbol [MAX_TABLES, 256]."""
    if native:
        from cags_kernels import motion

        return motion.count_symbols(tables, symbols)
    return np.bincount(tables.astype(np.int64) * 256 + symbols, minlength=256 * MAX_TABLES).reshape(MAX_TABLES, 256)


def _encoded(
    made: Sequence[Table], tables: U8, symbols: U8, runs: NDArray[np.int64], lanes: int
) -> tuple[NDArray[np.uint32], U16]:
    states = np.full(lanes, _LOW, np.uint64)
    frequencies, firsts = _shares(made)
    frequency = frequencies[tables, symbols].astype(np.uint64)
    first = firsts[tables, symbols].astype(np.uint64)
    out: list[NDArray[Any]] = []
    end = len(symbols)
    for run in runs[::-1].tolist():
        for row in range((run + lanes - 1) // lanes - 1, -1, -1):
            at = slice(end - run + row * lanes, min(end - run + (row + 1) * lanes, end))
            f, x = frequency[at], states[: at.stop - at.start]
            full = x >= f << np.uint64(32 - PROBABILITY_BITS)
            out.append(x[full].astype("<u2"))
            x = np.where(full, x >> np.uint64(16), x)
            states[: len(x)] = (x // f << np.uint64(PROBABILITY_BITS)) + x % f + first[at]
        end -= run
    words = np.concatenate([np.zeros(0, "<u2"), *reversed(out)]).astype("<u2")
    return states.astype(np.uint32), words


class Decoder:
    """Reads what :func:`encode` wrote, run by run. Raises :class:`DecodeError` for damaged data."""

    def __init__(self, data: bytes | memoryview) -> None:
        view = memoryview(data)
        if len(view) < _HEAD.size:
            raise DecodeError("symbols: are cut short")
        self._lanes, self.tables, count = _HEAD.unpack_from(view)
        if not 1 <= self._lanes <= MAX_LANES or not 1 <= self.tables <= MAX_TABLES:
            raise DecodeError(f"symbols: {self._lanes} lanes and {self.tables} tables are outside the allowed range")
        tables, at = read_tables(view[_HEAD.size :], self.tables)
        rest = view[_HEAD.size + at :]
        if len(rest) != 4 * self._lanes + 2 * count:
            raise DecodeError(f"symbols: {len(rest)} bytes of states and words, {4 * self._lanes + 2 * count} expected")
        self._frequencies, self._firsts = _shares(tables)
        symbols = (np.repeat(np.arange(len(t.frequencies), dtype=np.uint8), t.frequencies) for t in tables)
        self._symbols = np.stack(list(symbols))
        self._states = np.frombuffer(rest, "<u4", self._lanes).astype(np.uint64)
        self._words = np.frombuffer(rest, "<u2", count, 4 * self._lanes).astype(np.uint64)
        self._at = 0

    @property
    def read_bytes(self) -> int:
        """Bytes of words that were read."""
        return 2 * self._at

    def take(self, which: U8) -> U8:
        """The next symbols [n], by the table of each [n]."""
        if len(which) and int(which.max()) >= self.tables:
            raise DecodeError(f"symbols: table {int(which.max())} of {self.tables} is asked for")
        out = np.empty(len(which), np.uint8)
        for first in range(0, len(which), self._lanes):
            self._row(which[first : first + self._lanes], out[first : first + self._lanes])
        return out

    def _row(self, which: U8, out: U8) -> None:
        x = self._states[: len(which)]
        slot = x & np.uint64(TOTAL - 1)
        out[:] = self._symbols[which, slot]
        x = self._frequencies[which, out] * (x >> np.uint64(PROBABILITY_BITS)) + slot - self._firsts[which, out]
        low = x < _LOW
        wanted = int(low.sum())
        if self._at + wanted > len(self._words):
            raise DecodeError("symbols: end too early")
        x[low] = (x[low] << np.uint64(16)) | self._words[self._at : self._at + wanted]
        self._at += wanted
        self._states[: len(which)] = x

    def finish(self) -> None:
        """Check that everything was read."""
        if self._at != len(self._words) or (self._states != _LOW).any():
            raise DecodeError("symbols: the data does not end where its symbols do")


class NativeDecoder:
    """The same by the kernel."""

    def __init__(self, data: bytes | memoryview) -> None:
        from cags_kernels import motion

        with refused():
            self.kernel = motion.SymbolDecoder(data)

    def take(self, which: U8) -> U8:
        """The next symbols [n], by the table of each [n]."""
        with refused():
            return self.kernel.take(which)

    def finish(self) -> None:
        """Check that everything was read."""
        with refused():
            self.kernel.finish()


@contextmanager
def refused() -> Iterator[None]:
    """Turns what a kernel says of damaged data into :class:`DecodeError`."""
    from cags_kernels import motion

    try:
        yield
    except motion.DamagedError as error:
        raise DecodeError(f"symbols: {error}") from error


def decoder(data: bytes | memoryview, *, native: bool | None = None) -> Decoder | NativeDecoder:
    """What reads ``data``; ``native`` None takes the kernel where there is one. Raises :class:`DecodeError`."""
    native = cags_kernels.native_available() if native is None else native
    return NativeDecoder(data) if native else Decoder(data)
