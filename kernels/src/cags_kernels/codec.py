"""The C interface of the codec: packed codes to attribute values, the GIL released while a call runs."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cags_kernels.library import address, check, fields, library, native, sized

F32: TypeAlias = NDArray[np.float32]
U32: TypeAlias = NDArray[np.uint32]

MOST_BITS = 16
"""Of a part of a code that is an index by itself."""

COLUMNS = ("quats", "log_scales", "logit_opacities", "sh0", "sh_rest")

_Pointer, _int32, _int64 = ctypes.c_void_p, ctypes.c_int32, ctypes.c_int64


@native("CagsCodecAttribute")
class _Attribute(ctypes.Structure):
    _fields_ = [
        *((name, _Pointer) for name in ("layer_bits", "table", "leaves", "spreads")),
        *((name, _int32) for name in ("layers", "dim", "below_bits", "column", "offset")),
        ("lengths", _int64 * 4),
    ]


@native("CagsCodecTile")
class _Tile(ctypes.Structure):
    _fields_ = [
        ("count", _int64),
        ("before", _Pointer),
        ("data", ctypes.c_char_p),
        ("before_length", _int64),
        ("data_bytes", _int64),
        ("attributes", _int32),
        ("rotation", _int32),
        ("strides", _int32 * len(COLUMNS)),
    ]


@native("CagsCodecTargets")
class _Targets(ctypes.Structure):
    _fields_ = [
        *(("codes", _Pointer), ("columns", _Pointer * len(COLUMNS))),
        *(("codes_length", _int64), ("column_lengths", _int64 * len(COLUMNS))),
    ]


@dataclass(frozen=True, eq=False)
class CodecAttribute:
    """How one attribute's codes are read; see ``cags_common.tiles.dequantise``. Arrays are C-contiguous."""

    layer_bits: NDArray[np.uint8]  # [layers] bits of the fresh layers, coarse first
    table: F32  # [2**bits, dim]
    leaves: F32 | None  # [2**leaf bits, dim]
    spreads: F32 | None
    below_bits: int
    """Lowest bits of a code that are an index into ``table`` where there are ``leaves``."""
    column: str
    offset: int
    """First float of a row of ``column`` that the value goes to."""

    def structure(self) -> _Attribute:
        """What the library takes. Raises ``ValueError`` for tables that do not fit."""
        self._check()
        *arrays, lengths = fields(self.layer_bits, self.table, self.leaves, self.spreads)
        numbers = (len(self.layer_bits), self.table.shape[1], self.below_bits, COLUMNS.index(self.column), self.offset)
        made = _Attribute(*arrays, *numbers, lengths)
        made.arrays = self  # of Python alone: whose memory it is
        return made

    def _rows(self) -> int:
        """Codes that the tables have an entry for."""
        return len(self.table) if self.leaves is None else len(self.leaves) << self.below_bits

    def _check(self) -> None:
        if (self.leaves is None) != (self.spreads is None) or self.column not in COLUMNS or self.offset < 0:
            raise ValueError(f"column {self.column!r} + {self.offset}: leaves and spreads belong together")
        for name in ("table", "leaves", "spreads"):
            array = getattr(self, name)
            if array is None:
                continue
            if array.dtype != np.float32 or array.ndim != 2 or not array.flags.c_contiguous or 0 in array.shape:
                raise ValueError(f"{name} of {array.dtype} and shape {array.shape}: C-contiguous float32 [codes, dim]")
        if self.leaves is not None and self.spreads is not None:
            if not self.leaves.shape == self.spreads.shape == (len(self.leaves), self.table.shape[1]):
                raise ValueError(f"leaves {self.leaves.shape}, spreads {self.spreads.shape}, table {self.table.shape}")
            if not 0 <= self.below_bits <= MOST_BITS or len(self.table) < 1 << self.below_bits:
                raise ValueError(f"a table of {len(self.table)} rows for {self.below_bits} bits")
        if self.layer_bits.dtype != np.uint8 or self.layer_bits.ndim != 1:
            raise ValueError(f"layer_bits of {self.layer_bits.dtype} and shape {self.layer_bits.shape}")
        if 1 << int(self.layer_bits.sum(dtype=np.int64)) > self._rows():
            raise ValueError(f"codes of {self.layer_bits.tolist()} bits for {self._rows()} entries")


def dequantise(
    attributes: Sequence[_Attribute],
    data: bytes,
    before: U32 | None,
    columns: Mapping[str, F32],
    *,
    rodrigues: bool,
) -> U32:
    """Fill ``columns`` (name -> [n, ...] C-contiguous) and return the codes [attributes, n].

    ``data`` holds the fresh layers, attribute by attribute; ``before`` [attributes, n] the codes that they continue.
    Raises ``KernelError`` for data of another length and for codes that lead beyond the tables, ``ValueError`` for
    arrays that do not fit; nothing is written then.
    """
    count = len(columns["quats"])
    for name in COLUMNS:
        array = columns[name]
        if array.dtype != np.float32 or len(array) != count or not (array.flags.c_contiguous and array.flags.writeable):
            raise ValueError(f"column {name} of {array.dtype} and shape {array.shape} for {count} splats")
    codes = np.empty((len(attributes), count), np.uint32)
    if before is not None and (before.dtype, before.shape, before.flags.c_contiguous) != (
        codes.dtype,
        codes.shape,
        True,
    ):
        raise ValueError(f"codes of {before.dtype} and shape {before.shape}, expected {codes.shape}")
    *pointers, (before_length, codes_length, *lengths) = fields(before, codes, *(columns[name] for name in COLUMNS))
    tile = _Tile(
        *(count, pointers[0], data, before_length, len(data), len(attributes), int(rodrigues)),
        tuple(size // max(count, 1) for size in lengths),
    )
    targets = _Targets(pointers[1], tuple(pointers[2:]), codes_length, tuple(lengths))
    given = (_Attribute * len(attributes))(*attributes)
    check(library().cags_codec_dequantise(ctypes.byref(tile), given, ctypes.byref(targets)), "codec_dequantise")
    return codes


def positions(cells: F32, origin: NDArray[np.float64], step: float) -> F32:
    """``origin`` [3] + ``cells`` [n, 3] x ``step``, computed in double precision."""
    if cells.dtype != np.float32 or cells.ndim != 2 or cells.shape[1] != 3 or origin.shape != (3,):
        raise ValueError(f"cells of {cells.dtype} and shape {cells.shape}, origin of shape {origin.shape}")
    cells, means = np.ascontiguousarray(cells), np.empty(cells.shape, np.float32)
    origin = np.ascontiguousarray(origin, np.float64)
    call = library().cags_codec_positions
    status = call(*sized(cells), address(origin), ctypes.c_double(step), *sized(means))
    check(status, "codec_positions")
    return means


@native("CagsCodecSymbols")
class _Symbols(ctypes.Structure):
    _fields_ = [
        *((name, _Pointer) for name in ("prefixes", "nearest", "frequencies")),
        *((name, _int32) for name in ("bits", "prefix_bits")),
        ("lengths", _int64 * 3),
    ]


class DamagedCodesError(ValueError):
    """Codes that are not what an encoder wrote; the message says why, for a sentence that begins with what it is of."""


_DAMAGE = {16: "end too early", 18: "the data does not end where its symbols do"}


@dataclass(frozen=True, eq=False)
class Symbols:
    """How the codes of one layer are coded; see ``cags_common.tiles.contexts``."""

    prefixes: NDArray[np.uint8] | None  # [n]
    nearest: NDArray[np.int32]  # [n, 2]
    frequencies: NDArray[np.uint16]  # [contexts, 2**bits]
    bits: int
    prefix_bits: int

    def structure(self) -> _Symbols:
        """What the library takes; valid while ``self`` lives. Raises ``ValueError`` for arrays that do not fit."""
        for name, kind in (("prefixes", np.uint8), ("nearest", np.int32), ("frequencies", np.uint16)):
            array = getattr(self, name)
            if array is not None and (array.dtype != kind or not array.flags.c_contiguous):
                raise ValueError(f"{name} of {array.dtype}: C-contiguous {np.dtype(kind)} is expected")
        *arrays, lengths = fields(self.prefixes, self.nearest, self.frequencies)
        return _Symbols(*arrays, self.bits, self.prefix_bits, lengths)


def nearest(cells: F32) -> NDArray[np.int32]:
    """Of splats at ``cells`` [n, 3] the two nearest ones [n, 2] whose codes come before; -1: none."""
    if cells.dtype != np.float32 or cells.ndim != 2 or cells.shape[1] != 3:
        raise ValueError(f"cells of {cells.dtype} and shape {cells.shape}")
    cells, found = np.ascontiguousarray(cells), np.empty((len(cells), 2), np.int32)
    check(library().cags_codec_nearest(*sized(cells), *sized(found)), "codec_nearest")
    return found


def decode(symbols: Symbols, data: bytes | memoryview, lanes: int) -> tuple[NDArray[np.uint8], bytes]:
    """The codes [n] of one layer, and the same packed.

    Raises :class:`DamagedCodesError`, and ``KernelError`` for what does not fit.
    """
    count = len(symbols.nearest)
    codes, packed = np.empty(count, np.uint8), np.empty((count * symbols.bits + 7) // 8, np.uint8)
    given = symbols.structure()
    call = library().cags_codec_decode
    read = bytes(data)
    sizes = (read, _int64(len(read)), _int64(lanes), *sized(codes), *sized(packed))
    status = call(ctypes.byref(given), *sizes)
    if status in _DAMAGE:
        raise DamagedCodesError(_DAMAGE[status])
    check(status, "codec_decode")
    return codes, packed.tobytes()


def encode(symbols: Symbols, codes: NDArray[np.uint8], lanes: int) -> tuple[NDArray[np.uint32], NDArray[np.uint16]]:
    """Final states [lanes] and words of the ``codes`` [n]. Raises ``KernelError`` for what does not fit."""
    states, words, count = np.empty(lanes, np.uint32), np.empty(len(codes), np.uint16), _int64()
    given = symbols.structure()
    call = library().cags_codec_encode
    sizes = (*sized(codes), _int64(lanes), *sized(states), *sized(words))
    check(call(ctypes.byref(given), *sizes, ctypes.byref(count)), "codec_encode")
    return states, words[: count.value]
