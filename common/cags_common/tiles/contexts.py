"""Codes by context: what a splat's neighbours have makes its own codes likely.

The codes of one layer of an attribute are coded in an order in which every splat but the first comes between two
others: in the order of the tile, which is Morton order, first index 0, then the odd multiples of the largest power of
two, of half of it, and so on. A splat's *near* ones are the two nearest, by the positions of LoD 0, of those that lie
one and three such distances before and behind it. A base code is coded by the probabilities for what the nearest one
has, and whether the second one has the same. Codes of a further layer are coded by those for the splat's own *prefix*,
its code without this layer, and what the nearest splat of the same prefix has, if one of the two has it.

Probabilities are the bundle's: they travel with the codebooks, in one byte each. Symbols are coded by asymmetric
numeral systems as in :mod:`cags_common.coding.rans`, with lanes and words of that module. The definition is here; the
native kernel gives the same bytes. Layout: ``docs/bundle.md``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cags_kernels
from cags_common.coding.packing import U32, PackedCodes, pack_bits
from cags_common.coding.rans import U8
from cags_common.coding.tables import PROBABILITY_BITS, TOTAL
from cags_common.errors import DecodeError
from cags_common.geometry import F32

U16 = NDArray[np.uint16]
I32 = NDArray[np.int32]

MAX_CODE_BITS = 4
"""Bits of a layer that is coded by context."""

MAX_PREFIX_BITS = 6
"""Bits of the codes without it."""

MAX_LANES = 32
SYMBOLS_A_LANE = 1024
"""A lane costs four bytes, and makes decoding faster."""

_LOW = np.uint64(1 << 16)


def can_be_modelled(layer_bits: tuple[int, ...], layer: int) -> bool:
    """Whether a layer has few enough bits, and few enough before it, to be coded by context."""
    return layer_bits[layer] <= MAX_CODE_BITS and sum(layer_bits[:layer]) <= MAX_PREFIX_BITS


@dataclass(frozen=True, eq=False)
class ContextModel:
    """Probabilities of one layer's codes in each context."""

    bits: int
    prefix_bits: int
    """Zero for the lowest layer."""
    weights: U8  # [contexts, 2**bits], in proportion to the probabilities; a row of zeros: all alike

    def __post_init__(self) -> None:
        if self.weights.shape != self.shape_of(self.bits, self.prefix_bits):
            raise DecodeError(f"codebooks: probabilities {self.weights.shape} of {self.bits} bits")

    @staticmethod
    def shape_of(bits: int, prefix_bits: int) -> tuple[int, int]:
        """Contexts and symbols."""
        contexts = (1 + (2 << bits)) << prefix_bits if prefix_bits else 2 << bits
        return contexts, 1 << bits

    @staticmethod
    def of(counts: NDArray[Any], bits: int, prefix_bits: int) -> ContextModel:
        """The model for codes that occur ``counts`` [contexts, symbols] times.

        What was seldom seen is as likely as the same prefix, or all, make it.
        """
        shape = ContextModel.shape_of(bits, prefix_bits)
        seen = counts.reshape(1 << prefix_bits, -1, shape[1]).astype(np.float64)
        everything = seen.sum(axis=(0, 1)) + 0.5
        alike = seen.sum(axis=1, keepdims=True) + PRIOR * everything / everything.sum()
        likely = seen + PRIOR * alike / alike.sum(axis=2, keepdims=True)
        halvings = np.rint(-2 * np.log2(likely / likely.max(axis=2, keepdims=True))) / 2  # few values take few bytes
        return ContextModel(bits, prefix_bits, np.rint(255 * 2.0**-halvings).astype(np.uint8).reshape(shape))

    @cached_property
    def frequencies(self) -> U16:
        """Of each symbol in each context [contexts, symbols], of 4096; none is zero."""
        weights = self.weights.astype(np.int64)
        weights[weights.sum(axis=1) == 0] = 1
        symbols = weights.shape[1]
        shares = 1 + weights * (TOTAL - symbols) // weights.sum(axis=1, keepdims=True)
        shares[np.arange(len(shares)), weights.argmax(axis=1)] += TOTAL - shares.sum(axis=1)
        return np.asarray(shares, np.uint16)

    @cached_property
    def costs(self) -> F32:
        """Bits of each symbol in each context [contexts, symbols]."""
        return (PROBABILITY_BITS - np.log2(self.frequencies)).astype(np.float32)

    def contexts(self, codes: NDArray[Any], prefixes: NDArray[Any] | None, near: I32) -> NDArray[np.int64]:
        """The context [n] of each splat's code; ``codes`` [n] of this layer, ``prefixes`` [n] without it."""
        return self.contexts_at(slice(None), codes, prefixes, near)

    def contexts_at(
        self, rows: slice, codes: NDArray[Any], prefixes: NDArray[Any] | None, near: I32
    ) -> NDArray[np.int64]:
        """The same of the splats at ``rows`` only."""
        first, second = near[rows, 0], near[rows, 1]
        by_first, by_second = codes[first].astype(np.int64), codes[second].astype(np.int64)
        if prefixes is None:
            return np.where(first < 0, 0, 2 * by_first + ((second >= 0) & (by_first == by_second)))
        own, symbols = prefixes[rows].astype(np.int64), 1 << self.bits
        with_first = (first >= 0) & (prefixes[first] == own)
        with_second = (second >= 0) & (prefixes[second] == own)
        state = np.where(with_first, 1 + by_first, np.where(with_second, 1 + symbols + by_second, 0))
        return own * (1 + 2 * symbols) + state


PRIOR = 4.0
"""How many codes what is known of all contexts together weighs in each of them."""


def coding_runs(count: int) -> Iterator[slice]:
    """Rows in the order of coding; contexts of a run depend on earlier ones alone."""
    if count:
        yield slice(0, 1)
    step = 1 << (count - 1).bit_length() >> 1 if count > 1 else 0
    while step:
        yield slice(step, count, 2 * step)
        step //= 2


def nearest(cells: F32, *, native: bool | None = None) -> I32:
    """The near ones [n, 2] of splats at integer ``cells`` [n, 3] in the order of their tile; -1: none."""
    if _is_native(native):
        from cags_kernels import codec

        return codec.nearest(cells)
    count, wide = len(cells), cells.astype(np.float64)
    near = np.full((count, 2), -1, np.int32)
    for rows in list(coding_runs(count))[1:]:
        at, step = np.arange(count)[rows], rows.start
        candidates = at + step * np.array([-1, 1, -3, 3])[:, None]
        known = (candidates >= 0) & (candidates < count)
        squares = np.square(wide[np.clip(candidates, 0, count - 1)] - wide[at]).sum(axis=2)
        order = np.argsort(np.where(known, squares, np.inf), axis=0, kind="stable")[:2]
        near[rows] = np.where(np.take_along_axis(known, order, 0), np.take_along_axis(candidates, order, 0), -1).T
    return near


def lanes_for(count: int) -> int:
    """How many lanes code so many symbols."""
    return min(max(count // SYMBOLS_A_LANE, 1), MAX_LANES)


def encode_codes(
    model: ContextModel, codes: NDArray[Any], prefixes: U8 | None, near: I32, *, native: bool | None = None
) -> bytes:
    """The ``codes`` [n] of one layer, or the same packed where that is not longer. ``prefixes`` [n]: None for bases."""
    small = np.ascontiguousarray(codes, np.uint8)
    lanes, packed = lanes_for(len(small)), pack_bits(small.astype(np.uint32), model.bits)
    if _is_native(native):
        from cags_kernels import codec

        states, words = codec.encode(_symbols(model, prefixes, near), small, lanes)
    else:
        states, words = _encoded(model, small, prefixes, near, lanes)
    data = states.astype("<u4").tobytes() + words.astype("<u2").tobytes()
    return data if len(data) < len(packed) else packed


def decode_codes(
    data: bytes | memoryview, model: ContextModel, prefixes: U8 | None, near: I32, *, native: bool | None = None
) -> tuple[U8, PackedCodes]:
    """Inverse of :func:`encode_codes`: the codes [n], and the same packed. Raises :class:`DecodeError`."""
    count = len(near)
    size = (count * model.bits + 7) // 8
    if len(data) == size:
        packed = PackedCodes(bytes(data), model.bits)
        return packed.unpack(count).astype(np.uint8), packed
    lanes = lanes_for(count)
    if len(data) > size or len(data) < 4 * lanes or len(data) % 2:
        raise DecodeError(f"codes: {len(data)} bytes for {count} codes of {model.bits} bits")
    if _is_native(native):
        from cags_kernels import codec

        try:
            codes, bits = codec.decode(_symbols(model, prefixes, near), data, lanes)
        except codec.DamagedCodesError as error:
            raise DecodeError(f"codes: {error}") from error
        return codes, PackedCodes(bits, model.bits)
    codes = _decoded(data, model, prefixes, near, lanes)
    return codes, PackedCodes(pack_bits(codes.astype(np.uint32), model.bits), model.bits)


def with_layer(prefixes: U8, codes: U8, bits: int) -> U8:
    """Prefixes [n] of the next layer: these, followed by the ``codes`` [n] of this one."""
    return np.asarray((prefixes << np.uint8(bits)) | codes, np.uint8)


def counted(model: ContextModel, codes: U32, prefixes: U8 | None, near: I32) -> NDArray[np.int64]:
    """How often each symbol occurs in each context [contexts, symbols]."""
    contexts, symbols = model.weights.shape
    at = model.contexts(codes, prefixes, near) * symbols + codes.astype(np.int64)
    return np.bincount(at, minlength=contexts * symbols).reshape(contexts, symbols)


def _is_native(native: bool | None) -> bool:
    return cags_kernels.native_available() if native is None else native


def _symbols(model: ContextModel, prefixes: U8 | None, near: I32) -> Any:
    from cags_kernels import codec

    return codec.Symbols(prefixes, near, model.frequencies, model.bits, model.prefix_bits)


def _firsts(model: ContextModel) -> NDArray[np.uint64]:
    return (np.cumsum(model.frequencies, axis=1) - model.frequencies).astype(np.uint64)


def _encoded(
    model: ContextModel, codes: U8, prefixes: U8 | None, near: I32, lanes: int
) -> tuple[NDArray[np.uint32], U16]:
    states, firsts = np.full(lanes, _LOW, np.uint64), _firsts(model)
    contexts = model.contexts(codes, prefixes, near)
    out: list[U16] = []
    for rows in reversed(list(coding_runs(len(codes)))):
        which, symbols = contexts[rows], codes[rows]
        for row in range((len(which) - 1) // lanes, -1, -1):
            at = slice(row * lanes, (row + 1) * lanes)
            frequency = model.frequencies[which[at], symbols[at]].astype(np.uint64)
            x = states[: len(frequency)]
            full = x >= frequency << np.uint64(32 - PROBABILITY_BITS)
            out.append(x[full].astype(np.uint16))
            x = np.where(full, x >> np.uint64(16), x)
            states[: len(x)] = (x // frequency << np.uint64(PROBABILITY_BITS)) + x % frequency
            states[: len(x)] += firsts[which[at], symbols[at]]
    return states.astype(np.uint32), np.concatenate([np.zeros(0, np.uint16), *reversed(out)])


def _decoded(data: bytes | memoryview, model: ContextModel, prefixes: U8 | None, near: I32, lanes: int) -> U8:
    states = np.frombuffer(data, "<u4", lanes).astype(np.uint64)
    words, at, codes = np.frombuffer(data, "<u2", offset=4 * lanes).astype(np.uint64), 0, np.zeros(len(near), np.uint8)
    firsts = _firsts(model)
    for rows in coding_runs(len(near)):
        which = model.contexts_at(rows, codes, prefixes, near)
        symbols = np.zeros(len(which), np.uint8)
        for first in range(0, len(which), lanes):
            context = which[first : first + lanes]
            x = states[: len(context)]
            slot = x & np.uint64(TOTAL - 1)
            symbol = (firsts[context] <= slot[:, None]).sum(axis=1) - 1
            x = model.frequencies[context, symbol] * (x >> np.uint64(PROBABILITY_BITS)) + slot - firsts[context, symbol]
            low = x < _LOW
            wanted = int(low.sum())
            if at + wanted > len(words):
                raise DecodeError("codes: end too early")
            x[low] = (x[low] << np.uint64(16)) | words[at : at + wanted]
            at += wanted
            states[: len(context)] = x
            symbols[first : first + lanes] = symbol
        codes[rows] = symbols
    if at != len(words) or (states != _LOW).any():
        raise DecodeError("codes: the data does not end where its symbols do")
    return codes
