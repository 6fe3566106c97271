"""Scalable Vector Quantisation: what a decoder needs to turn layered codes back into attribute values.

A codebook is a binary tree of cluster centres, flattened (paper, section "Scalable Vector Quantization"): the leading
bits of a code name an ancestor, so that cutting bits off the end leaves the code of a coarser cluster. The leading
``layer_bits[0]`` bits form the base layer, each later group of bits one enhancement layer. A second, shared tree may
refine the leaves of the first: multi-stage vector quantisation, whose tables stay small where one tree's would double
with each bit.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import numpy as np

from cags_common.coding.packing import U32, gunzip_bounded, gzip_bytes
from cags_common.errors import DecodeError
from cags_common.geometry import F32
from cags_common.tiles.attributes import ATTRIBUTE_DIMS, SH_REST_ATTRIBUTES

MAX_BASE_BITS = 8
"""Base codes travel as single bytes."""

MAX_LAYER_BITS = 8
MAX_STAGE_BITS = 16
"""Longest code of one stage; bounds a stage's tables to 2**16 rows a layer."""

MAX_CODEBOOK_BYTES = 16 * 2**20
"""Bound on the unpacked codebooks of a bundle."""

_MAGIC = b"CAGSCB01"
_HALF = 1
"""Flag: values are float16."""


@dataclass(frozen=True, eq=False)
class Codebook:
    """One attribute's layered codebook: a tree, and optionally a second one that refines its leaves.

    ``tables[k]`` holds the rows that codes of ``k + 1`` layers stand for; a leaf that ends early is repeated below
    itself, so that every code of the full length is valid. Layers from ``tree_layers`` on belong to the second tree,
    whose bits count alone: its rows are offsets in units of the first tree's leaf's ``spreads`` [leaves, dim].
    """

    attribute: str
    layer_bits: tuple[int, ...]
    tables: tuple[F32, ...]
    tree_layers: int | None = None
    """Layers of the first tree; None for all."""
    spreads: F32 | None = None

    def __post_init__(self) -> None:
        tree = self.first_stage
        stages = [self.layer_bits[:tree], self.layer_bits[tree:]]
        named = f"codebook {self.attribute!r}: layers of {self.layer_bits} bits"
        bounds = all(1 <= bits <= MAX_LAYER_BITS for bits in self.layer_bits)
        if not stages[0] or not bounds or max(map(sum, stages)) > MAX_STAGE_BITS:
            raise DecodeError(f"{named} are outside the allowed range")
        shapes = [(1 << bits, self.dim) for stage in stages for bits in accumulate(stage)]
        if [table.shape for table in self.tables] != shapes:
            raise DecodeError(f"{named} do not fit its tables {[table.shape for table in self.tables]}")
        spreads = None if self.spreads is None else self.spreads.shape
        if spreads != ((1 << sum(stages[0]), self.dim) if stages[1] else None):
            raise DecodeError(f"{named} do not fit its spreads {spreads}")

    @property
    def first_stage(self) -> int:
        """Layers of the first tree."""
        return len(self.layer_bits) if self.tree_layers is None else self.tree_layers

    @property
    def dim(self) -> int:
        """Length of a value."""
        return ATTRIBUTE_DIMS[self.attribute]

    @property
    def enhancement_layers(self) -> int:
        """Number of layers above the base."""
        return len(self.layer_bits) - 1

    def code_bits(self, layers: int) -> int:
        """Bits of a code that holds the first ``layers`` layers."""
        return sum(self.layer_bits[:layers])

    def bits_of(self, layer: int) -> int:
        """Bits that ``layer`` (0 = base) adds to a code. Raises :class:`DecodeError` for one that has not come."""
        if layer >= len(self.layer_bits):
            raise DecodeError(f"layer {layer} of {self.attribute!r} came before its codebook, which ends at that")
        return self.layer_bits[layer]

    def begins(self, other: Codebook) -> bool:
        """Whether the first layers of ``other`` are those of this book."""
        if self.attribute != other.attribute or len(self.layer_bits) > len(other.layer_bits):
            return False
        short = other.truncated(len(self.layer_bits))
        same = self.layer_bits == short.layer_bits and self.first_stage == short.first_stage
        return same and all(map(np.array_equal, self.tables, short.tables))

    def truncated(self, layers: int) -> Codebook:
        """The codebook for codes that end after their first ``layers`` layers (1 = base only)."""
        bits, tables = self.layer_bits[:layers], self.tables[:layers]
        if layers <= self.first_stage:
            return Codebook(self.attribute, bits, tables)
        return Codebook(self.attribute, bits, tables, self.tree_layers, self.spreads)

    def lookup(self, codes: U32, layers: int) -> F32:
        """Values [n, dim] of codes [n] that hold the first ``layers`` (1 = base only) layers' bits."""
        table, tree = self.tables[layers - 1], self.first_stage
        if self.spreads is None or layers <= tree:
            return table.take(codes, axis=0)
        below = np.uint32(self.code_bits(layers) - self.code_bits(tree))
        leaves = codes >> below
        offsets = table.take(codes & np.uint32((1 << int(below)) - 1), axis=0)
        offsets *= self.spreads.take(leaves, axis=0)
        offsets += self.tables[tree - 1].take(leaves, axis=0)
        return offsets

    def prefix(self, codes: U32, layers: int) -> U32:
        """Codes of full length cut to their first ``layers`` layers."""
        return codes >> np.uint32(self.code_bits(len(self.layer_bits)) - self.code_bits(layers))

    def layer(self, codes: U32, layer: int) -> U32:
        """The bits [n] that ``layer`` (0 = base) adds, out of codes of full length."""
        return self.prefix(codes, layer + 1) & np.uint32((1 << self.layer_bits[layer]) - 1)


class CodebookSet:
    """The codebooks of a bundle by attribute, in coding order. It may hold base layers only, and get the others
    later (:meth:`extend`).
    """

    def __init__(self, books: dict[str, Codebook]) -> None:
        self._books = {name: books[name] for name in ATTRIBUTE_DIMS if name in books}

    def __iter__(self) -> Iterator[Codebook]:
        return iter(self._books.values())

    def __len__(self) -> int:
        return len(self._books)

    def __getitem__(self, attribute: str) -> Codebook:
        try:
            return self._books[attribute]
        except KeyError:
            raise DecodeError(f"no codebook for attribute {attribute!r}; there are: {', '.join(self._books)}") from None

    @property
    def attributes(self) -> tuple[str, ...]:
        """Names of the attributes, in coding order."""
        return tuple(self._books)

    @property
    def sh_degree(self) -> int:
        """Degree of the harmonics."""
        return sum(name in self._books for name in SH_REST_ATTRIBUTES)

    @property
    def base(self) -> CodebookSet:
        """The same codebooks with base layers only."""
        return CodebookSet({book.attribute: book.truncated(1) for book in self})

    def extend(self, other: CodebookSet) -> None:
        """Add the further layers of ``other``. Raises :class:`DecodeError` if its first layers are others."""
        if self.attributes != other.attributes or not all(map(Codebook.begins, self, other)):
            raise DecodeError("codebooks: do not go on with those that came before")
        self._books = other._books

    def to_bytes(self) -> bytes:
        """Serialise; equal codebooks give equal bytes."""
        body = b"".join([struct.pack("<B", len(self._books)), *(_book_bytes(book) for book in self)])
        return _MAGIC + gzip_bytes(body)

    @staticmethod
    def from_bytes(data: bytes | memoryview) -> CodebookSet:
        """Inverse of :meth:`to_bytes`. Raises :class:`DecodeError` for anything else, without large allocations."""
        if bytes(data[: len(_MAGIC)]) != _MAGIC:
            raise DecodeError(f"codebooks: begin with {bytes(data[:8])!r}, expected {_MAGIC!r} (another version?)")
        body = _Cursor(gunzip_bounded(memoryview(data)[len(_MAGIC) :], MAX_CODEBOOK_BYTES, "codebooks"))
        count = body.byte()
        if count > len(ATTRIBUTE_DIMS):  # tables grow to a thousand times the bytes that describe them
            raise DecodeError(f"codebooks: {count} of them for {len(ATTRIBUTE_DIMS)} attributes")
        books = [_read_book(body) for _ in range(count)]
        body.finish()
        if len({book.attribute for book in books}) != len(books):
            raise DecodeError("codebooks: an attribute appears twice")
        return CodebookSet({book.attribute: book for book in books})


class _Cursor:
    """Reads bytes in order and never past the end."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def take(self, size: int) -> bytes:
        end = self._at + size
        if end > len(self._data):
            raise DecodeError(f"codebooks: cut short at byte {len(self._data)}")
        part, self._at = self._data[self._at : end], end
        return part

    def byte(self) -> int:
        return self.take(1)[0]

    def finish(self) -> None:
        if self._at != len(self._data):
            raise DecodeError(f"codebooks: {len(self._data) - self._at} bytes too many")


def _book_bytes(book: Codebook) -> bytes:
    """Attribute index, flags, layers of both stages, bits, tables, spreads.

    A table is a mask of the entries that differ from their parent's value, and those values.
    """
    arrays = [*book.tables] if book.spreads is None else [*book.tables, book.spreads]
    half = all(np.array_equal(array.astype(np.float16), array) for array in arrays)
    index = list(ATTRIBUTE_DIMS).index(book.attribute)
    head = bytes([index, _HALF * half, book.first_stage, len(book.layer_bits) - book.first_stage, *book.layer_bits])
    kind = "<f2" if half else "<f4"
    parts = [head]
    for layer, (bits, table) in enumerate(zip(book.layer_bits, book.tables, strict=True)):
        root = layer in (0, book.first_stage)
        parents = np.zeros((1, book.dim), np.float32) if root else book.tables[layer - 1]
        fresh = (table != np.repeat(parents, 1 << bits, axis=0)).any(axis=1)
        parts += [np.packbits(fresh, bitorder="little").tobytes(), table[fresh].astype(kind).tobytes()]
    if book.spreads is not None:
        parts.append(book.spreads.astype(kind).tobytes())
    return b"".join(parts)


def _read_book(body: _Cursor) -> Codebook:
    index, flags, tree, above = body.byte(), body.byte(), body.byte(), body.byte()
    if index >= len(ATTRIBUTE_DIMS) or flags & ~_HALF:
        raise DecodeError(f"codebooks: attribute number {index} with flags {flags} is unknown")
    attribute = list(ATTRIBUTE_DIMS)[index]
    layer_bits = tuple(body.take(tree + above))
    stages = layer_bits[:tree], layer_bits[tree:]
    if not tree or 0 in layer_bits or layer_bits[0] > MAX_BASE_BITS or max(map(sum, stages)) > MAX_STAGE_BITS:
        raise DecodeError(f"codebook {attribute!r}: layers of {layer_bits} bits are outside the allowed range")
    kind = np.dtype("<f2" if flags & _HALF else "<f4")
    tables = tuple(table for stage in stages for table in _read_stage(body, stage, attribute, kind))
    if not above:
        return Codebook(attribute, layer_bits, tables)
    leaves = 1 << sum(stages[0])
    spreads = _read_values(body, leaves, attribute, kind)
    return Codebook(attribute, layer_bits, tables, tree, spreads)


def _read_stage(body: _Cursor, layer_bits: tuple[int, ...], attribute: str, kind: np.dtype[Any]) -> Iterator[F32]:
    table = np.zeros((1, ATTRIBUTE_DIMS[attribute]), np.float32)
    for bits in layer_bits:
        table = np.repeat(table, 1 << bits, axis=0)
        mask = np.frombuffer(body.take((len(table) + 7) // 8), np.uint8)
        fresh = np.unpackbits(mask, count=len(table), bitorder="little").astype(bool)
        table[fresh] = _read_values(body, int(fresh.sum()), attribute, kind)
        yield table


def _read_values(body: _Cursor, rows: int, attribute: str, kind: np.dtype[Any]) -> F32:
    dim = ATTRIBUTE_DIMS[attribute]
    values = np.frombuffer(body.take(kind.itemsize * rows * dim), kind).reshape(rows, dim).astype(np.float32)
    if not np.isfinite(values).all():
        raise DecodeError(f"codebook {attribute!r}: holds a value that is not finite")
    return values
