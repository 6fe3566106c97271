"""The C interface of the codec: packed codes to attribute values, the GIL released while a call runs."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cags_kernels.library import check, library, native

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
    ]


@native("CagsCodecTile")
class _Tile(ctypes.Structure):
    _fields_ = [
        ("count", _int64),
        ("before", _Pointer),
        ("data", ctypes.c_char_p),
        ("data_bytes", _int64),
        ("attributes", _int32),
        ("rotation", _int32),
        ("strides", _int32 * len(COLUMNS)),
    ]


@native("CagsCodecTargets")
class _Targets(ctypes.Structure):
    _fields_ = [("codes", _Pointer), ("columns", _Pointer * len(COLUMNS))]


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
        arrays = (_address(a) for a in (self.layer_bits, self.table, self.leaves, self.spreads))
        numbers = (len(self.layer_bits), self.table.shape[1], self.below_bits, COLUMNS.index(self.column), self.offset)
        made = _Attribute(*arrays, *numbers)
        made.rows, made.arrays = self._rows(), self  # of Python alone: what codes may reach, and whose memory it is
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
    Raises ``KernelError`` for data of another length, ``ValueError`` for arrays that do not fit.
    """
    count = len(columns["quats"])
    for name in COLUMNS:
        array = columns[name]
        if array.dtype != np.float32 or len(array) != count or not (array.flags.c_contiguous and array.flags.writeable):
            raise ValueError(f"column {name} of {array.dtype} and shape {array.shape} for {count} splats")
    if before is not None:
        _check_before(attributes, before, count)
    codes = np.empty((len(attributes), count), np.uint32)
    strides = [columns[name].size // max(count, 1) for name in COLUMNS]
    tile = _Tile(
        *(count, _address(before), data, len(data), len(attributes), int(rodrigues)), (_int32 * len(COLUMNS))(*strides)
    )
    targets = _Targets(_address(codes), (_Pointer * len(COLUMNS))(*(_address(columns[name]) for name in COLUMNS)))
    given = (_Attribute * len(attributes))(*attributes)
    check(library().cags_codec_dequantise(ctypes.byref(tile), given, ctypes.byref(targets)), "codec_dequantise")
    return codes


def _check_before(attributes: Sequence[_Attribute], before: U32, count: int) -> None:
    """Codes that further bits are appended to must leave the tables room for them."""
    if before.dtype != np.uint32 or before.shape != (len(attributes), count) or not before.flags.c_contiguous:
        raise ValueError(f"codes of {before.dtype} and shape {before.shape}, expected {(len(attributes), count)}")
    for attribute, most in zip(attributes, before.max(axis=1, initial=0).tolist(), strict=True):
        layer_bits = ctypes.cast(attribute.layer_bits, ctypes.POINTER(ctypes.c_uint8))[: attribute.layers]
        if (most + 1) << sum(layer_bits) > attribute.rows:
            raise ValueError(f"code {most} continued by {sum(layer_bits)} bits for {attribute.rows} entries")


def positions(cells: F32, origin: NDArray[np.float64], step: float) -> F32:
    """``origin`` [3] + ``cells`` [n, 3] x ``step``, computed in double precision."""
    if cells.dtype != np.float32 or cells.ndim != 2 or cells.shape[1] != 3 or origin.shape != (3,):
        raise ValueError(f"cells of {cells.dtype} and shape {cells.shape}, origin of shape {origin.shape}")
    cells, means = np.ascontiguousarray(cells), np.empty(cells.shape, np.float32)
    origin = np.ascontiguousarray(origin, np.float64)
    call = library().cags_codec_positions
    status = call(_int64(len(cells)), _address(cells), _address(origin), ctypes.c_double(step), _address(means))
    check(status, "codec_positions")
    return means


def _address(array: NDArray[Any] | None) -> ctypes.c_void_p:
    return _Pointer(None if array is None else array.ctypes.data)
