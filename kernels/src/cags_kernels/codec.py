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
