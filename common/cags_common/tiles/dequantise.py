"""Packed codes to splats: unpack the bits, look the codes up, and put the attributes together.

Two ways with the same result, bit for bit: numpy on :meth:`Codebook.lookup` and :func:`join_attributes`, which is the
definition, and the native kernel, which does all of it in one pass and releases the GIL.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

import cags_kernels
from cags_common.coding.packing import U32, PackedCodes
from cags_common.errors import DecodeError
from cags_common.geometry import F32
from cags_common.splats import SH_REST_OF_DEGREE, Splats
from cags_common.tiles.attributes import ROTATION_PARTS, SH_REST_ATTRIBUTES, alpha_logits, join_attributes
from cags_common.tiles.svq import Codebook, CodebookSet

_COLUMN_OF = {
    "scale": ("log_scales", 0),
    "rotation": ("quats", 1),
    "rotation_real": ("quats", 0),
    "rotation_imag": ("quats", 1),
    "opacity": ("logit_opacities", 0),
    "alpha": ("logit_opacities", 0),
    "sh0": ("sh0", 0),
    **{name: ("sh_rest", 3 * SH_REST_OF_DEGREE[degree]) for degree, name in enumerate(SH_REST_ATTRIBUTES)},
}
"""Attribute -> the column of :class:`Splats` and the first number of a row that its values go to."""


@dataclass(frozen=True, slots=True)
class FreshLayers:
    """New layers of one attribute, to be appended to its codes: ``parts[i]`` is layer ``first + i``."""

    first: int
    parts: tuple[PackedCodes, ...]

    @property
    def end(self) -> int:
        """Layers that the codes hold with these."""
        return self.first + len(self.parts)


class Dequantiser:
    """Turns codes into splats by one set of codebooks. Thread-safe."""

    def __init__(self, books: CodebookSet, *, native: bool | None = None) -> None:
        """``native`` None takes the kernel where there is one. Raises :class:`DecodeError` for a missing attribute."""
        self.books = books
        nothing = tuple(FreshLayers(0, (PackedCodes(b"", book.layer_bits[0]),)) for book in books)
        self._reference(np.zeros((0, 3), np.float32), None, nothing)
        wanted = native_available() if native is None else native
        self._native = _NativeTables(books) if wanted and _one_form_each(books) else None

    def extend(self, books: CodebookSet) -> None:
        """Add the further layers of ``books``. Raises :class:`DecodeError` if its first layers are others."""
        self.books.extend(books)
        if self._native is not None:
            self._native = _NativeTables(self.books)  # whoever uses the last ones has codes of base layers alone

    def __call__(
        self, means: F32, before: U32 | None, fresh: Sequence[FreshLayers], into: Splats | None = None
    ) -> tuple[Splats, U32]:
        """The splats at ``means`` [n, 3], and their codes [attributes, n] with the ``fresh`` layers appended.

        ``before`` [attributes, n] holds the codes so far, None before the base; ``fresh`` has an item an attribute, in
        coding order. The splats are written to the arrays of ``into`` [n] where it is given. Raises
        :class:`DecodeError` for layers of a wrong length and for an ``into`` of another SH degree.
        """
        native = self._native
        if native is None or len(means) == 0:
            splats, codes = self._reference(means, before, fresh)
            return splats.written_to(into), codes
        return native(means, before, fresh, into)

    def _reference(self, means: F32, before: U32 | None, fresh: Sequence[FreshLayers]) -> tuple[Splats, U32]:
        n = len(means)
        codes = np.zeros((len(self.books), n), np.uint32) if before is None else before.copy()
        values = {}
        for row, book, layers in zip(codes, self.books, fresh, strict=True):
            for part in layers.parts:
                row[:] = (row << np.uint32(part.bits)) | part.unpack(n)
            values[book.attribute] = book.lookup(row, layers.end)
        return join_attributes(means, values), codes


class _NativeTables:
    """The codebooks in the kernel's form."""

    def __init__(self, books: CodebookSet) -> None:
        self._books = tuple(books)
        self._rodrigues = "rotation" in books.attributes
        self._degree = books.sh_degree
        self._alpha_to_logit = any(book.attribute == "alpha" and book.spreads is not None for book in self._books)
        self._kept: dict[tuple[int, int, int], tuple[Any, Any]] = {}

    def __call__(
        self, means: F32, before: U32 | None, fresh: Sequence[FreshLayers], into: Splats | None
    ) -> tuple[Splats, U32]:
        from cags_kernels import codec

        n = len(means)
        out = Splats.unwritten(n, self._degree) if into is None else into
        if out.sh_degree != self._degree:
            raise DecodeError(f"splats have SH degree {self._degree}, their place {out.sh_degree}")
        columns = {name: array for name, array in out.arrays() if name != "means"}
        attributes = [self._attribute(i, layers.first, layers.end) for i, layers in enumerate(fresh)]
        data = b"".join(part.data for layers in fresh for part in layers.parts)
        try:
            codes = codec.dequantise(attributes, data, before, columns, rodrigues=self._rodrigues)
        except cags_kernels.KernelError as error:
            raise DecodeError(f"layers of {n} splats have {len(data)} bytes, which is another length") from error
        if self._alpha_to_logit:
            out.logit_opacities[:] = alpha_logits(out.logit_opacities)
        if into is None:
            return replace(out, means=means), codes
        into.means[:] = means
        return into, codes

    def _attribute(self, index: int, first: int, end: int) -> Any:
        """The kernel's structure for one attribute whose codes go from ``first`` to ``end`` layers."""
        key = (index, first, end)
        if key not in self._kept:
            made = _codec_attribute(self._books[index], first, end)
            self._kept[key] = made, made.structure()
        return self._kept[key][1]


def _codec_attribute(book: Codebook, first: int, end: int) -> Any:
    from cags_kernels.codec import CodecAttribute

    column, offset = _COLUMN_OF[book.attribute]
    layer_bits = np.array(book.layer_bits[first:end], np.uint8)
    table = book.tables[end - 1]
    if book.spreads is None or end <= book.first_stage:
        if book.attribute == "alpha" and book.spreads is None:
            table = alpha_logits(table)
        return CodecAttribute(layer_bits, np.ascontiguousarray(table), None, None, 0, column, offset)
    leaves, below = book.tables[book.first_stage - 1], book.code_bits(end) - book.code_bits(book.first_stage)
    table, leaves, spreads = (np.ascontiguousarray(array) for array in (table, leaves, book.spreads))
    return CodecAttribute(layer_bits, table, leaves, spreads, below, column, offset)


def _one_form_each(books: CodebookSet) -> bool:
    """Whether no attribute comes in two forms, of which one would have to be ignored."""
    names = set(books.attributes)
    return not ({"alpha", "opacity"} <= names or ("rotation" in names and names & set(ROTATION_PARTS)))


def positions(cells: Any, origin: F32, step: float) -> F32:
    """Means [n, 3]: ``origin`` [3] + integer ``cells`` [n, 3] x ``step``, in double precision and then rounded."""
    wide = origin.astype(np.float64)
    if cells.dtype == np.float32 and native_available():
        from cags_kernels import codec

        return codec.positions(cells, wide, step)
    means: F32 = (wide + cells.astype(np.float64) * step).astype(np.float32)
    return means


@cache
def native_available() -> bool:
    """Whether the kernel is there. The first answer holds for the process."""
    return cags_kernels.native_available()
