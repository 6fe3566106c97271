"""Static probabilities of small symbols, and how they travel: in a few bits each.

A table has a *weight* for each symbol up to the last one that occurs: 0 where it does not occur, else 1 to ``1 +
HALVINGS steps``, each worth ``2**(1 / steps)`` times the one before. Weights differ little from symbol to symbol, so
their differences are coded, folded, in Golomb-Rice codes. The encoder chooses the steps and the Rice parameter for all
tables of a piece of data together: where few symbols are coded, coarse tables cost less than they lose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cags_common.errors import DecodeError

U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]
I64 = NDArray[np.int64]

PROBABILITY_BITS = 12
TOTAL = 1 << PROBABILITY_BITS
"""Frequencies of a table add up to this."""

MAX_SYMBOLS = 255
"""A byte says how many a table has; none stands for the table before."""

HALVINGS = 12
"""From the largest weight to the least."""

FINEST = 4
"""Steps a halving at most."""

STEPS = (1, 2, FINEST)
MAX_RICE = 3

_MANTISSAS = (16384, 19484, 23170, 27554)  # 2**14 times the powers of 2**(1 / FINEST)
_WORTH = np.array([0, *(_MANTISSAS[k % FINEST] << k // FINEST for k in range(HALVINGS * FINEST + 1))], np.int64)


@dataclass(frozen=True, eq=False)
class Table:
    """Probabilities of the symbols 0 to ``len(weights) - 1``."""

    weights: U8  # [symbols]
    steps: int

    @staticmethod
    def of(counts: NDArray[Any], steps: int = FINEST) -> Table:
        """The table for symbols that occur ``counts`` [256] times: every one that occurs has a chance."""
        top = HALVINGS * steps
        at = counts.nonzero()[0]
        if not len(at):
            return Table(np.array([1 + top], np.uint8), steps)
        seen = counts[at].astype(np.float64)
        weights = np.zeros(int(at[-1]) + 1, np.uint8)
        weights[at] = 1 + np.maximum(np.rint(top + steps * np.log2(seen / seen.max())), 0)
        return Table(weights, steps)

    @cached_property
    def frequencies(self) -> U32:
        """Of each symbol [symbols], adding up to :data:`TOTAL`."""
        weights = self.weights.astype(np.int64)
        worth = _WORTH[np.where(weights > 0, 1 + (weights - 1) * (FINEST // self.steps), 0)]
        occurs = weights > 0
        shares = np.where(occurs, 1 + worth * (TOTAL - int(occurs.sum())) // worth.sum(), 0)
        shares[worth.argmax()] += TOTAL - shares.sum()
        return shares.astype(np.uint32)

    @cached_property
    def differences(self) -> I64:
        """Of each weight from the one before, the first from the largest there is; folded."""
        steps = self.weights.astype(np.int64)
        steps[1:] -= self.weights[:-1]
        steps[0] -= 1 + HALVINGS * self.steps
        return 2 * steps ^ steps >> 63

    def bits(self, rice: int) -> int:
        """On the wire, with this Rice parameter."""
        return 8 + int((self.differences >> rice).sum()) + (1 + rice) * len(self.weights)

    def cost(self, counts: NDArray[Any]) -> float:
        """Bits of symbols that occur ``counts`` [256] times."""
        at = counts.nonzero()[0]
        return float((counts[at] * (PROBABILITY_BITS - np.log2(self.frequencies[at]))).sum())


@dataclass(frozen=True, eq=False)
class Tables:
    """Tables of one piece of data, in their order; each may serve several numbers in a row."""

    tables: Sequence[Table]
    lengths: Sequence[int]
    """How many numbers each one serves."""
    rice: int

    @staticmethod
    def of(counts: I64) -> Tables:
        """Those for symbols that occur ``counts`` [tables, 256] times, in as few bytes as they and the symbols take."""
        pooled, lengths = _merged(counts)
        best, least = None, np.inf
        for steps in STEPS:
            tables = [Table.of(one, steps) for one in pooled]
            symbols = sum(table.cost(one) for table, one in zip(tables, pooled, strict=True))
            for rice in range(MAX_RICE + 1):
                bits = symbols + sum(table.bits(rice) for table in tables)
                if bits < least:
                    best, least = Tables(tables, lengths, rice), bits
        assert best is not None
        return best

    @property
    def each(self) -> list[Table]:
        """The table of every number."""
        return [table for table, length in zip(self.tables, self.lengths, strict=True) for _ in range(length)]

    def to_bytes(self) -> bytes:
        """The form, then the tables, bit by bit from the lowest: how many symbols each has (0: the one before again),
        then the differences of the weights.
        """
        form = STEPS.index(self.tables[0].steps) | self.rice << 2
        parts = [_bits_of(form, 8)]
        for table, length in zip(self.tables, self.lengths, strict=True):
            parts.append(_bits_of(len(table.weights), 8))
            for difference in table.differences.tolist():
                parts.append("1" * (difference >> self.rice) + "0" + _bits_of(difference, self.rice))
            parts.append("0" * 8 * (length - 1))
        bits = np.frombuffer("".join(parts).encode(), np.uint8) - ord("0")
        return np.packbits(bits, bitorder="little").tobytes()


def read_tables(data: memoryview, count: int) -> tuple[list[Table], int]:
    """``count`` tables from the beginning of ``data``, and the bytes that they take. Raises :class:`DecodeError`."""
    bits = _Bits(data)
    form = bits.number(8)
    if form >> 2 > MAX_RICE or form & 3 >= len(STEPS):
        raise DecodeError(f"symbols: tables of the form {form}")
    steps, rice = STEPS[form & 3], form >> 2
    tables: list[Table] = []
    for _ in range(count):
        symbols = bits.number(8)
        if symbols:
            tables.append(_read_table(bits, symbols, steps, rice))
        elif tables:
            tables.append(tables[-1])
        else:
            raise DecodeError("symbols: the first table is as the one before")
    return tables, bits.bytes


def _read_table(bits: _Bits, symbols: int, steps: int, rice: int) -> Table:
    most = 1 + HALVINGS * steps
    weight, weights = most, np.zeros(symbols, np.uint8)
    for symbol in range(symbols):
        folded = bits.run(2 * most) << rice | bits.number(rice)
        weight += -(folded + 1 >> 1) if folded & 1 else folded >> 1
        if not 0 <= weight <= most:
            raise DecodeError(f"symbols: a weight of {weight}, of at most {most}")
        weights[symbol] = weight
    if not weights.any():
        raise DecodeError("symbols: a table in which nothing occurs")
    return Table(weights, steps)


class _Bits:
    """Bits of ``data``, the lowest of each byte first."""

    def __init__(self, data: memoryview) -> None:
        self._data, self._at = data, 0

    @property
    def bytes(self) -> int:
        """Bytes that were begun."""
        return (self._at + 7) // 8

    def _next(self) -> int:
        byte, bit = divmod(self._at, 8)
        if byte >= len(self._data):
            raise DecodeError("symbols: the tables are cut short")
        self._at += 1
        return self._data[byte] >> bit & 1

    def number(self, count: int) -> int:
        return sum(self._next() << bit for bit in range(count))

    def run(self, most: int) -> int:
        """Ones before the next zero."""
        length = 0
        while self._next():
            length += 1
            if length > most:
                raise DecodeError(f"symbols: a difference of more than {most}")
        return length


def _bits_of(number: int, count: int) -> str:
    """The lowest ``count`` bits of a number, the lowest first."""
    return "".join(str(number >> bit & 1) for bit in range(count))


MERGED_STEPS, MERGED_RICE = 2, 1
"""Form in which tables are compared while they are merged."""


def _merged(counts: I64) -> tuple[list[I64], list[int]]:
    """Counts of tables that serve several numbers in a row, and how many each serves.

    Two in a row are merged as long as that saves more bits of tables than it costs of symbols.
    """

    def cost(pooled: I64) -> float:
        table = Table.of(pooled, MERGED_STEPS)
        return table.cost(pooled) + table.bits(MERGED_RICE)

    pooled, lengths = list(counts), [1] * len(counts)
    costs = [cost(one) for one in pooled]
    joint = [cost(one + other) for one, other in pairwise(pooled)]
    while joint:
        saved = [costs[i] + costs[i + 1] - joint[i] - 8 for i in range(len(joint))]
        at = max(range(len(saved)), key=lambda i: saved[i])
        if saved[at] <= 0:
            break
        pooled[at], lengths[at], costs[at] = pooled[at] + pooled[at + 1], lengths[at] + lengths[at + 1], joint[at]
        del pooled[at + 1], lengths[at + 1], costs[at + 1], joint[at]
        for i in (at - 1, at):
            if 0 <= i < len(joint):
                joint[i] = cost(pooled[i] + pooled[i + 1])
    return pooled, lengths
