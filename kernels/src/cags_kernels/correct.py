"""The C interface of the client's last step (``cags_common.correction``): numpy arrays in and out, the GIL released."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cags_kernels.buffers import BufferPool
from cags_kernels.library import check, library, native

F32: TypeAlias = NDArray[np.float32]
F64: TypeAlias = NDArray[np.float64]
I16: TypeAlias = NDArray[np.int16]

_Pointer, _int32, _int64, _float = ctypes.c_void_p, ctypes.c_int32, ctypes.c_int64, ctypes.c_float

LANES = 4
"""Of a pixel of what is lacking: red, green, blue, opacity."""

UNIT = 32767
"""What a difference of 1 is there."""

VETO_CELL_PX = 16
"""Side of the cells of a coarse veto."""


@native("CagsLackInput")
class _LackInput(ctypes.Structure):
    _fields_ = [
        *((name, _Pointer) for name in ("coded", "own")),
        *((name, _int32) for name in ("width", "height")),
        *((name, _float) for name in ("knee", "error")),
        ("threads", _int32),
        *((name, _int64) for name in ("coded_length", "own_length")),
    ]


@native("CagsAddInput")
class _AddInput(ctypes.Structure):
    _fields_ = [
        *((name, _Pointer) for name in ("rgb", "alpha", "depth", "lack", "veto")),
        *((name, _int32) for name in ("width", "height", "reference_width", "reference_height")),
        ("m", _float * 9),
        ("b", _float * 3),
        *((name, _float) for name in ("cell_x", "cell_y")),
        ("stride", _int32),
        *((name, _float) for name in ("depth_tolerance", "slope_cells", "border_px", "hole_alpha")),
        *((name, _int32) for name in ("coarse_veto", "threads")),
        *((name, _int64) for name in ("rgb_length", "alpha_length", "depth_length", "lack_length", "veto_length")),
    ]


@dataclass(frozen=True, eq=False)
class DrawnView:
    """A client's view."""

    rgb: F32  # [H, W, 3]
    alpha: F32  # [H, W]
    depth: F32  # [H, W]; what is not finite or not positive is a hole


@dataclass(frozen=True, eq=False)
class AddParameters:
    """See ``cags_common.correction.base``: ``Placement`` and ``CorrectSettings``."""

    matrix: F64  # [3, 4]
    cell_px: tuple[float, float]
    stride: int
    depth_tolerance: float
    slope_cells: float
    border_px: float
    hole_alpha: float
    threads: int


_buffers = BufferPool()


def expanded(coded: F32, knee: float, threads: int) -> I16:
    """A difference [h, w, 3] that was companded with ``knee``, ready to be sampled [h + 2, w + 1, 4, 2]: its edge
    repeated once around it, and beside each pixel's lanes those of the pixel to the right.

    Raises ``KernelError`` and, for an array that does not fit, ``ValueError``.
    """
    return _lack(coded, None, knee, 0.0, threads)


def compared(coded: F32, own: F32, error: float, threads: int) -> I16:
    """What a picture [h, w, 3], in which coding left a mean squared ``error``, says is lacking in the client's ``own``
    view from its camera [h, w, 3]: as :func:`expanded` gives a difference.
    """
    return _lack(coded, own, 1.0, error, threads)


def _lack(coded: F32, own: F32 | None, knee: float, error: float, threads: int) -> I16:
    height, width = coded.shape[:2]
    coded = _checked(coded, (height, width, 3))
    own = None if own is None else _checked(own, coded.shape)
    out = np.empty((height + 2, width + 1, LANES, 2), np.int16)
    lengths = map(_length, (coded, own))
    given = _LackInput(_address(coded), _address(own), width, height, knee, error, threads, *lengths)
    check(library().cags_lack(ctypes.byref(given), _address(out), _int64(out.size)), "lack")
    return out


def add(view: DrawnView, lacking: I16, veto: F32 | None, parameters: AddParameters) -> tuple[F32, F32]:
    """The frame [H, W, 3] in [0, 1] and the confidence [H, W]: ``view`` with ``lacking`` laid over.

    ``veto`` is [H, W] or [ceil(H / 16), ceil(W / 16)]. Raises ``KernelError`` and, for arrays that do not fit,
    ``ValueError``.
    """
    height, width = view.depth.shape
    rgb, alpha = _checked(view.rgb, (height, width, 3)), _checked(view.alpha, (height, width))
    depth = _checked(view.depth, (height, width))
    if lacking.dtype != np.int16 or lacking.shape[2:] != (LANES, 2) or not lacking.flags.c_contiguous:
        raise ValueError(
            f"what is lacking as {lacking.dtype} of shape {lacking.shape}, expected int16 as expanded() makes it"
        )
    veto, coarse = _checked_veto(veto, (height, width))
    p = parameters
    given = _AddInput(
        *map(_address, (rgb, alpha, depth, lacking, veto)),
        *(width, height, lacking.shape[1] - 1, lacking.shape[0] - 2),
        (_float * 9)(*np.ravel(p.matrix[:, :3])),
        (_float * 3)(*p.matrix[:, 3]),
        *(*p.cell_px, p.stride, p.depth_tolerance, p.slope_cells, p.border_px, p.hole_alpha),
        *(coarse, p.threads),
        *map(_length, (rgb, alpha, depth, lacking, veto)),
    )
    shown, confidence = _buffers.empty((height, width, 3)), _buffers.empty((height, width))
    out = (_address(shown), _int64(shown.size), _address(confidence), _int64(confidence.size))
    check(library().cags_add_lack(ctypes.byref(given), *out), "add")
    return shown, confidence


def _checked_veto(veto: F32 | None, shape: tuple[int, int]) -> tuple[F32 | None, bool]:
    if veto is None:
        return None, False
    coarse = veto.shape != shape
    wanted = (-(-shape[0] // VETO_CELL_PX), -(-shape[1] // VETO_CELL_PX)) if coarse else shape
    return _checked(veto, wanted), coarse


def _checked(array: F32, shape: tuple[int, ...]) -> F32:
    if array.shape != shape:
        raise ValueError(f"array of shape {array.shape}, expected {shape}")
    return np.ascontiguousarray(array, dtype=np.float32)


def _length(array: NDArray[np.generic] | None) -> int:
    return 0 if array is None else array.size


def _address(array: NDArray[np.generic] | None) -> ctypes.c_void_p:
    return _Pointer(None if array is None else array.ctypes.data)
