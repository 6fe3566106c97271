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
from numpy.typing import NDArray

from cags_common.coding.packing import U32, gunzip_bounded, gzip_numbers
from cags_common.errors import DecodeError
from cags_common.geometry import F32, F64
from cags_common.tiles.attributes import ATTRIBUTE_DIMS, SH_REST_ATTRIBUTES
from cags_common.tiles.contexts import ContextModel, can_be_modelled

MAX_BASE_BITS = 8
"""Base codes travel as single bytes."""

MAX_LAYER_BITS = 8
MAX_STAGE_BITS = 16
"""Longest code of one stage; bounds a stage's tables to 2**16 rows a layer."""

MAX_CODEBOOK_BYTES = 16 * 2**20
"""Bound on the unpacked codebooks of a bundle."""

MAX_STEPS = 2**15 - 1
"""Most steps between an entry of a table and its parent."""

MODELLED_LAYERS = 8
"""A byte says which of so many first layers have a model."""

MAX_EXPONENT = 100
"""Steps of tables are powers of two from 2**-100 to 2**100."""

_MAGIC = b"CAGSCB02"


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
    models: tuple[ContextModel | None, ...] = ()
    """Of the first layers: how codes of tiles are coded by context; None, or none: they are packed."""

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
        self._check_models()
        spreads = None if self.spreads is None else self.spreads.shape
        if spreads != ((1 << sum(stages[0]), self.dim) if stages[1] else None):
            raise DecodeError(f"{named} do not fit its spreads {spreads}")

    def _check_models(self) -> None:
        if len(self.models) > len(self.layer_bits):
            raise DecodeError(f"codebook {self.attribute!r}: models of {len(self.models)} layers")
        for layer, model in enumerate(self.models):
            if model is None:
                continue
            expected = self.layer_bits[layer], sum(self.layer_bits[:layer])
            if not can_be_modelled(self.layer_bits, layer) or (model.bits, model.prefix_bits) != expected:
                raise DecodeError(f"codebook {self.attribute!r}: layer {layer} cannot have such a model")

    def model(self, layer: int) -> ContextModel | None:
        """How codes of ``layer`` (0 = base) are coded by context; None: they are packed."""
        return self.models[layer] if layer < len(self.models) else None

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
        layers = len(self.layer_bits)
        short = other.truncated(layers)
        same = self.layer_bits == short.layer_bits and self.first_stage == short.first_stage
        modelled = all(map(_same_model, map(self.model, range(layers)), map(short.model, range(layers))))
        return same and modelled and all(map(np.array_equal, self.tables, short.tables))

    def truncated(self, layers: int) -> Codebook:
        """The codebook for codes that end after their first ``layers`` layers (1 = base only)."""
        bits, tables, models = self.layer_bits[:layers], self.tables[:layers], self.models[:layers]
        if layers <= self.first_stage:
            return Codebook(self.attribute, bits, tables, models=models)
        return Codebook(self.attribute, bits, tables, self.tree_layers, self.spreads, models)

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


def _same_model(one: ContextModel | None, other: ContextModel | None) -> bool:
    if one is None or other is None:
        return one is other
    return np.array_equal(one.weights, other.weights)


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
        """Serialise; equal codebooks give equal bytes.

        Raises :class:`ValueError` for tables whose entries are not whole numbers of steps, the same power of two for a
        column, from their parents: up to ``MAX_STEPS``, and exact as float32.
        """
        body = b"".join([struct.pack("<B", len(self._books)), *(_book_bytes(book) for book in self)])
        return _MAGIC + gzip_numbers(body)

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
    """Attribute index, layers of both stages, bits, tables, spreads, models.

    A table is a power of two for each column and, in units of it, what its entries differ from their parents by.
    """
    index = list(ATTRIBUTE_DIMS).index(book.attribute)
    parts = [bytes([index, book.first_stage, len(book.layer_bits) - book.first_stage, *book.layer_bits])]
    for layer, (bits, table) in enumerate(zip(book.layer_bits, book.tables, strict=True)):
        root = layer in (0, book.first_stage)
        parents = np.zeros((1, book.dim), np.float32) if root else book.tables[layer - 1]
        parts.append(_table_bytes(book.attribute, table, np.repeat(parents, 1 << bits, axis=0)))
    if book.spreads is not None:
        parts.append(_spread_bytes(book.attribute, book.spreads))
    known = [layer for layer in range(MODELLED_LAYERS) if book.model(layer) is not None]
    parts.append(bytes([sum(1 << layer for layer in known)]))
    parts += [model.weights.tobytes() for model in book.models if model is not None]
    return b"".join(parts)


def _table_bytes(attribute: str, table: F32, parents: F32) -> bytes:
    away = table.astype(np.float64) - parents
    exponents = np.array([_common_exponent(column) for column in away.T], np.int8)
    counts = np.rint(np.ldexp(away, -exponents.astype(np.int32))).astype(np.int64)
    if np.abs(counts).max() > MAX_STEPS or not np.array_equal(_stepped(parents, counts, exponents), table):
        raise ValueError(f"codebook {attribute!r}: a table is not on steps from its parents")
    folded = np.where(counts < 0, -2 * counts - 1, 2 * counts).astype("<u2")
    return exponents.tobytes() + folded.view(np.uint8).reshape(-1, 2).T.tobytes()


def _common_exponent(values: F64) -> int:
    """Exponent of the largest power of two of which all ``values`` [n] are multiples, if they have 15 bits at most."""
    largest = float(np.abs(values).max())
    if largest == 0:
        return 0
    finest = max(int(np.frexp(largest)[1]) - 15, -MAX_EXPONENT)
    counts = np.rint(np.ldexp(values, -finest)).astype(np.int64)
    together = int(np.bitwise_or.reduce(np.abs(counts)))
    return min(finest + (together & -together).bit_length() - 1, MAX_EXPONENT)


def _stepped(parents: F32, counts: NDArray[Any], exponents: NDArray[np.int8]) -> F32:
    """Entries [n, dim] that are ``counts`` steps of 2**exponents [dim] away from their parents [n, dim]."""
    with np.errstate(over="ignore"):  # of hostile codebooks, which are refused
        return parents + np.ldexp(counts.astype(np.float32), exponents.astype(np.int32))


def _spread_bytes(attribute: str, spreads: F32) -> bytes:
    """Spreads as float16 without sign and without the last seven bits of the fraction."""
    with np.errstate(over="ignore"):
        halves = spreads.astype(np.float16)
    words = halves.view(np.uint16)
    if not np.array_equal(halves, spreads) or (words & ~np.uint16(0x7F80)).any():
        raise ValueError(f"codebook {attribute!r}: spreads have more bits than are written")
    return (words >> 7).astype(np.uint8).tobytes()


def _read_book(body: _Cursor) -> Codebook:
    index, tree, above = body.byte(), body.byte(), body.byte()
    if index >= len(ATTRIBUTE_DIMS):
        raise DecodeError(f"codebooks: attribute number {index} is unknown")
    attribute = list(ATTRIBUTE_DIMS)[index]
    layer_bits = tuple(body.take(tree + above))
    stages = layer_bits[:tree], layer_bits[tree:]
    if not tree or 0 in layer_bits or layer_bits[0] > MAX_BASE_BITS or max(map(sum, stages)) > MAX_STAGE_BITS:
        raise DecodeError(f"codebook {attribute!r}: layers of {layer_bits} bits are outside the allowed range")
    tables = tuple(table for stage in stages for table in _read_stage(body, stage, attribute))
    if not above:
        return Codebook(attribute, layer_bits, tables, models=_read_models(body, layer_bits, attribute))
    words = np.frombuffer(body.take(ATTRIBUTE_DIMS[attribute] << sum(stages[0])), np.uint8).astype(np.uint16) << 7
    spreads = words.view(np.float16).reshape(-1, ATTRIBUTE_DIMS[attribute]).astype(np.float32)
    spreads = _finite(spreads, attribute)
    return Codebook(attribute, layer_bits, tables, tree, spreads, _read_models(body, layer_bits, attribute))


def _read_models(body: _Cursor, layer_bits: tuple[int, ...], attribute: str) -> tuple[ContextModel | None, ...]:
    which = body.byte()
    models: list[ContextModel | None] = []
    for layer in range(which.bit_length()):
        if not which >> layer & 1:
            models.append(None)
            continue
        if layer >= len(layer_bits) or not can_be_modelled(layer_bits, layer):
            raise DecodeError(f"codebook {attribute!r}: layer {layer} cannot have such a model")
        shape = ContextModel.shape_of(layer_bits[layer], sum(layer_bits[:layer]))
        weights = np.frombuffer(body.take(shape[0] * shape[1]), np.uint8).reshape(shape)
        models.append(ContextModel(layer_bits[layer], sum(layer_bits[:layer]), weights))
    return tuple(models)


def _read_stage(body: _Cursor, layer_bits: tuple[int, ...], attribute: str) -> Iterator[F32]:
    dim = ATTRIBUTE_DIMS[attribute]
    table = np.zeros((1, dim), np.float32)
    for bits in layer_bits:
        parents = np.repeat(table, 1 << bits, axis=0)
        exponents = np.frombuffer(body.take(dim), np.int8)
        planes = np.frombuffer(body.take(2 * parents.size), np.uint8).reshape(2, *parents.shape).astype(np.int32)
        folded = planes[0] | planes[1] << 8
        table = _finite(_stepped(parents, (folded >> 1) ^ -(folded & 1), exponents), attribute)
        yield table


def _finite(values: F32, attribute: str) -> F32:
    if not np.isfinite(values).all():
        raise DecodeError(f"codebook {attribute!r}: holds a value that is not finite")
    return values
