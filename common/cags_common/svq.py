"""Scalable Vector Quantisation: what a decoder needs to turn layered codes back into attribute values.

A codebook is a binary tree of cluster centres, flattened (paper, section "Scalable Vector Quantization"): the leading
bits of a code name an ancestor, so that cutting bits off the end leaves the code of a coarser cluster. The leading
``layer_bits[0]`` bits form the base layer, each later group of bits one enhancement layer.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from cags_common.attributes import ATTRIBUTE_DIMS
from cags_common.errors import DecodeError
from cags_common.geometry import F32
from cags_common.packing import U32, gunzip_bounded, gzip_bytes

MAX_BASE_BITS = 8
"""Base codes travel as single bytes."""

MAX_LAYER_BITS = 8
MAX_CODE_BITS = 16
"""Longest code; bounds a codebook's tables to 2**16 rows a layer."""

MAX_CODEBOOK_BYTES = 16 * 2**20
"""Bound on the unpacked codebooks of a bundle."""

_MAGIC = b"CAGSCB01"


@dataclass(frozen=True, eq=False)
class Codebook:
    """One attribute's layered codebook.

    ``tables[k]`` holds the values [2**(bits of the first k + 1 layers), dim] that codes of ``k + 1`` layers stand for;
    a leaf that ends early is repeated below itself, so that every code of the full length is valid.
    """

    attribute: str
    layer_bits: tuple[int, ...]
    tables: tuple[F32, ...]

    def __post_init__(self) -> None:
        bits = list(accumulate(self.layer_bits))
        if not bits or min(self.layer_bits) < 1 or max(self.layer_bits) > MAX_LAYER_BITS or bits[-1] > MAX_CODE_BITS:
            raise DecodeError(
                f"codebook {self.attribute!r}: layers of {self.layer_bits} bits are outside the allowed range"
            )
        shapes = [table.shape for table in self.tables]
        if shapes != [(1 << b, self.dim) for b in bits]:
            raise DecodeError(
                f"codebook {self.attribute!r}: tables {shapes} do not fit layers of {self.layer_bits} bits"
            )

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

    def lookup(self, codes: U32, layers: int) -> F32:
        """Values [n, dim] of codes [n] that hold the first ``layers`` (1 = base only) layers' bits."""
        return self.tables[layers - 1].take(codes, axis=0)

    def prefix(self, codes: U32, layers: int) -> U32:
        """Codes of full length cut to their first ``layers`` layers."""
        return codes >> np.uint32(self.code_bits(len(self.layer_bits)) - self.code_bits(layers))

    def layer(self, codes: U32, layer: int) -> U32:
        """The bits [n] that ``layer`` (0 = base) adds, out of codes of full length."""
        return self.prefix(codes, layer + 1) & np.uint32((1 << self.layer_bits[layer]) - 1)


class CodebookSet:
    """The codebooks of a bundle by attribute, in coding order."""

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
        books = [_read_book(body) for _ in range(body.byte())]
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
    """Attribute index, layer count, bits; then a layer: which entries differ from their parent's value, and those
    values.
    """
    index = list(ATTRIBUTE_DIMS).index(book.attribute)
    parts = [bytes([index, len(book.layer_bits), *book.layer_bits])]
    parents = np.zeros((1, book.dim), np.float32)
    for bits, table in zip(book.layer_bits, book.tables, strict=True):
        inherited = np.repeat(parents, 1 << bits, axis=0)
        fresh = (table.view(np.uint32) != inherited.view(np.uint32)).any(axis=1)
        parts += [np.packbits(fresh, bitorder="little").tobytes(), table[fresh].astype("<f4").tobytes()]
        parents = table
    return b"".join(parts)


def _read_book(body: _Cursor) -> Codebook:
    index, layers = body.byte(), body.byte()
    if index >= len(ATTRIBUTE_DIMS):
        raise DecodeError(f"codebooks: attribute number {index} is unknown")
    attribute = list(ATTRIBUTE_DIMS)[index]
    layer_bits = tuple(body.take(layers))
    if not 0 < sum(layer_bits) <= MAX_CODE_BITS or 0 in layer_bits or layer_bits[0] > MAX_BASE_BITS:
        raise DecodeError(f"codebook {attribute!r}: layers of {layer_bits} bits are outside the allowed range")
    tables: list[F32] = []
    table = np.zeros((1, ATTRIBUTE_DIMS[attribute]), np.float32)
    for bits in layer_bits:
        table = np.repeat(table, 1 << bits, axis=0)
        mask = np.frombuffer(body.take((len(table) + 7) // 8), np.uint8)
        fresh = np.unpackbits(mask, count=len(table), bitorder="little").astype(bool)
        values = np.frombuffer(body.take(4 * int(fresh.sum()) * table.shape[1]), "<f4")
        if not np.isfinite(values).all():
            raise DecodeError(f"codebook {attribute!r}: holds a value that is not finite")
        table[fresh] = values.reshape(-1, table.shape[1])
        tables.append(table)
    return Codebook(attribute, layer_bits, tuple(tables))
