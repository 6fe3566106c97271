"""Range asymmetric numeral systems (Duda 2013): entropy coding of small symbols by static tables.

Several lanes, each a coder of its own, share one stream of 16-bit words (Giesen 2014): numpy then works on a row of
lanes at once, and a kernel keeps its pipeline full. Tables travel with the data; which table a symbol uses may depend
on symbols of earlier calls. The definition is here; the native kernel gives the same symbols and the same bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cags_common.errors import DecodeError

U8 = NDArray[np.uint8]
U16 = NDArray[np.uint16]

PROBABILITY_BITS = 12
TOTAL = 1 << PROBABILITY_BITS
"""Frequencies of a table add up to this."""

MAX_SYMBOL = 255
MAX_LANES = 32
SYMBOLS_A_LANE = 4096
"""A lane costs four bytes; so many symbols pay for it."""

MAX_TABLES = 64
_LOW = 1 << 16
_HEAD = struct.Struct("<BBI")  # lanes, tables, words


@dataclass(frozen=True, eq=False)
class Table:
    """Static probabilities of the symbols 0 to ``len(frequencies) - 1``."""

    frequencies: NDArray[np.uint32]  # [symbols], adding up to TOTAL

    @staticmethod
    def of(counts: NDArray[Any]) -> Table:
        """The table for symbols that occur ``counts`` [256] times: every one that occurs has a chance of at least 1."""
        used = int(np.flatnonzero(counts)[-1]) + 1 if counts.any() else 1
        counts = np.asarray(counts[:used], np.int64)
        if not counts.any():
            return Table(np.array([TOTAL], np.uint32))
        shares = np.where(counts > 0, np.maximum(counts * TOTAL // counts.sum(), 1), 0)
        order = np.argsort(-counts, kind="stable")
        excess = int(shares.sum()) - TOTAL
        for at in order if excess > 0 else order[:1]:
            taken = min(excess, int(shares[at]) - 1) if excess > 0 else excess
            shares[at] -= taken
            excess -= taken
            if excess == 0:
                break
        return Table(shares.astype(np.uint32))

    def to_bytes(self) -> bytes:
        """The largest symbol, then each frequency: below 128 in one byte, else in two, the higher bits first."""
        out = bytearray([len(self.frequencies) - 1])
        for value in self.frequencies.tolist():
            out += bytes([value]) if value < 128 else bytes([128 | value >> 8, value & 255])
        return bytes(out)


def _read_tables(data: memoryview, count: int) -> tuple[list[Table], int]:
    """``count`` tables from the beginning of ``data``, and where they end. Raises :class:`DecodeError`."""
    tables, at = [], 0
    try:
        for _ in range(count):
            symbols, at = data[at] + 1, at + 1
            values = np.zeros(symbols, np.uint32)
            for i in range(symbols):
                first, at = data[at], at + 1
                if first >= 128:
                    first, at = (first & 127) << 8 | data[at], at + 1
                values[i] = first
            if int(values.sum()) != TOTAL:
                raise DecodeError(f"symbols: the frequencies of a table add up to {int(values.sum())}, not {TOTAL}")
            tables.append(Table(values))
    except IndexError as error:
        raise DecodeError("symbols: the tables are cut short") from error
    return tables, at


class _Tables:
    """Tables side by side, as both directions look them up."""

    def __init__(self, tables: Sequence[Table]) -> None:
        self.frequency = np.zeros((len(tables), 256), np.uint32)
        self.first = np.zeros((len(tables), 256), np.uint32)
        self.symbol = np.zeros((len(tables), TOTAL), np.uint8)
        for i, table in enumerate(tables):
            count = len(table.frequencies)
            self.frequency[i, :count] = table.frequencies
            self.first[i, 1:count] = np.cumsum(table.frequencies)[:-1]
            self.symbol[i] = np.repeat(np.arange(count, dtype=np.uint8), table.frequencies)


def encode(tables: U8, symbols: U8, runs: NDArray[np.int64]) -> bytes:
    """The ``symbols`` [n], each by its table [n], to be read in ``runs`` that add up to n. Same input, same bytes.

    Tables are numbered from 0; they are made from what occurs. Raises ``ValueError`` for more than ``MAX_TABLES``.
    """
    count = 1 + int(tables.max(initial=0))
    if count > MAX_TABLES:
        raise ValueError(f"symbols: table {count - 1} is asked for, the last one is {MAX_TABLES - 1}")
    if len(tables) != len(symbols) or int(runs.sum()) != len(symbols) or int(runs.min(initial=0)) < 0:
        raise ValueError(f"symbols: {len(symbols)} of them have {len(tables)} tables and runs of {int(runs.sum())}")
    counts = np.bincount(tables.astype(np.int64) * 256 + symbols, minlength=256 * count).reshape(count, 256)
    made = [Table.of(row) for row in counts]
    lanes = min(max(len(symbols) // SYMBOLS_A_LANE, 1), MAX_LANES)
    states, words = _encoded(_Tables(made), tables, symbols, runs, lanes)
    head = _HEAD.pack(lanes, count, len(words))
    return head + b"".join(table.to_bytes() for table in made) + states.astype("<u4").tobytes() + words.tobytes()


def _encoded(
    made: _Tables, tables: U8, symbols: U8, runs: NDArray[np.int64], lanes: int
) -> tuple[NDArray[np.uint64], U16]:
    states = np.full(lanes, _LOW, np.uint64)
    frequency = made.frequency[tables, symbols].astype(np.uint64)
    first = made.first[tables, symbols].astype(np.uint64)
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
    return states, words


class Decoder:
    """Reads what :func:`encode` wrote, run by run. Raises :class:`DecodeError` for damaged data."""

    def __init__(self, data: bytes | memoryview) -> None:
        view = memoryview(data)
        if len(view) < _HEAD.size:
            raise DecodeError("symbols: are cut short")
        self._lanes, self.tables, count = _HEAD.unpack_from(view)
        if not 1 <= self._lanes <= MAX_LANES or not 1 <= self.tables <= MAX_TABLES:
            raise DecodeError(f"symbols: {self._lanes} lanes and {self.tables} tables are outside the allowed range")
        tables, at = _read_tables(view[_HEAD.size :], self.tables)
        rest = view[_HEAD.size + at :]
        if len(rest) != 4 * self._lanes + 2 * count:
            raise DecodeError(f"symbols: {len(rest)} bytes of states and words, {4 * self._lanes + 2 * count} expected")
        self._tables = _Tables(tables)
        self._states = np.frombuffer(rest, "<u4", self._lanes).astype(np.uint64)
        self._words = np.frombuffer(rest, "<u2", count, 4 * self._lanes).astype(np.uint64)
        self._at = 0

    def take(self, which: U8) -> U8:
        """The next symbols [n], by the table of each [n]."""
        if len(which) and int(which.max()) >= self.tables:
            raise DecodeError(f"symbols: table {int(which.max())} of {self.tables} is asked for")
        out = np.empty(len(which), np.uint8)
        for first in range(0, len(which), self._lanes):
            self._row(which[first : first + self._lanes], out[first : first + self._lanes])
        return out

    def _row(self, which: U8, out: U8) -> None:
        tables, x = self._tables, self._states[: len(which)]
        slot = x & np.uint64(TOTAL - 1)
        out[:] = tables.symbol[which, slot]
        x = tables.frequency[which, out] * (x >> np.uint64(PROBABILITY_BITS)) + slot - tables.first[which, out]
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


def decoder(data: bytes | memoryview) -> Decoder:
    """The fastest decoder there is. Raises :class:`DecodeError` for damaged data."""
    return Decoder(data)
