"""The C interface of the codec: packed codes to attribute values, the GIL released while a call runs."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cags_kernels.library import check, library

F32: TypeAlias = NDArray[np.float32]
U32: TypeAlias = NDArray[np.uint32]

COLUMNS = ("quats", "log_scales", "logit_opacities", "sh0", "sh_rest")

_Pointer, _int32, _int64 = ctypes.c_void_p, ctypes.c_int32, ctypes.c_int64


class _Attribute(ctypes.Structure):
    _fields_ = [
        *((name, _Pointer) for name in ("layer_bits", "table", "leaves", "spreads")),
        *((name, _int32) for name in ("layers", "dim", "below_bits", "column", "offset")),
    ]


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


class _Targets(ctypes.Structure):
    _fields_ = [("codes", _Pointer), ("columns", _Pointer * len(COLUMNS))]


@dataclass(frozen=True, eq=False)
class CodecAttribute:
    """How one attribute's codes are read; see ``cags_common.dequantise``. Arrays are C-contiguous."""

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
        """What the library takes; valid while ``self`` lives."""
        arrays = (_address(a) for a in (self.layer_bits, self.table, self.leaves, self.spreads))
        numbers = (len(self.layer_bits), self.table.shape[1], self.below_bits, COLUMNS.index(self.column), self.offset)
        return _Attribute(*arrays, *numbers)


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
    Raises ``KernelError`` for data of another length.
    """
    count = len(columns["quats"])
    codes = np.empty((len(attributes), count), np.uint32)
    strides = [columns[name].size // max(count, 1) for name in COLUMNS]
    tile = _Tile(
        *(count, _address(before), data, len(data), len(attributes), int(rodrigues)), (_int32 * len(COLUMNS))(*strides)
    )
    targets = _Targets(_address(codes), (_Pointer * len(COLUMNS))(*(_address(columns[name]) for name in COLUMNS)))
    given = (_Attribute * len(attributes))(*attributes)
    check(library().cags_codec_dequantise(ctypes.byref(tile), given, ctypes.byref(targets)), "codec_dequantise")
    return codes


def positions(cells: F32, origin: NDArray[np.float64], step: float) -> F32:
    """``origin`` [3] + ``cells`` [n, 3] x ``step``, computed in double precision."""
    cells, means = np.ascontiguousarray(cells), np.empty(cells.shape, np.float32)
    call = library().cags_codec_positions
    status = call(_int64(len(cells)), _address(cells), _address(origin), ctypes.c_double(step), _address(means))
    check(status, "codec_positions")
    return means


def _address(array: NDArray[Any] | None) -> ctypes.c_void_p:
    return _Pointer(None if array is None else array.ctypes.data)
