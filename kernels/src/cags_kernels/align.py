"""The C interface of alignment and correction: numpy arrays in and out, the GIL released while a call runs."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cags_kernels.buffers import BufferPool
from cags_kernels.library import check, library

F32: TypeAlias = NDArray[np.float32]
F64: TypeAlias = NDArray[np.float64]

_Pointer, _int32, _float = ctypes.c_void_p, ctypes.c_int32, ctypes.c_float


class _Reprojection(ctypes.Structure):
    _fields_ = [
        ("depth", _Pointer),
        *((name, _int32) for name in ("width", "height", "reference_width", "reference_height")),
        ("m", _float * 9),
        ("b", _float * 3),
    ]


class _AlignInput(ctypes.Structure):
    _fields_ = [
        ("view", _Reprojection),
        ("reference", _Pointer),
        ("cell_x", _float),
        ("cell_y", _float),
        ("stride", _int32),
        *((name, _float) for name in ("depth_tolerance", "slope_cells", "border_px")),
        *((name, _int32) for name in ("erosion_radius", "erosion_iterations", "threads")),
    ]


class _AlignOutput(ctypes.Structure):
    _fields_ = [(name, _Pointer) for name in ("confidence", "occluded", "rgb")]


class _CorrectInput(ctypes.Structure):
    _fields_ = [
        ("view", _Reprojection),
        ("own", _Pointer),
        ("reference", _Pointer),
        ("radius_cells", _int32),
        ("gain_prior", _float),
        *((name, _float * 3) for name in ("fine_noise", "broad_noise")),
        ("fields", _Pointer),
        ("distorted", _Pointer),
        ("confidence", _Pointer),
        ("block_px", _int32),
        ("misregistration", _float),
        ("veil", _float),
        ("threads", _int32),
    ]


class _LayInput(ctypes.Structure):
    _fields_ = [
        *((name, _Pointer) for name in ("over", "share", "confidence")),
        *((name, ctypes.c_int64) for name in ("share_pitch", "shown_pitch")),
        *((name, _int32) for name in ("width", "height", "threads")),
    ]


class _CarryInput(ctypes.Structure):
    _fields_ = [
        *((name, _Pointer) for name in ("reference", "then", "now")),
        *((name, _int32) for name in ("width", "height", "radius")),
        *((name, _float) for name in ("caution", "plausible", "visible")),
        ("threads", _int32),
    ]


@dataclass(frozen=True, eq=False)
class Reprojection:
    """Client pixel (u, v) of depth D lies at ``m [u, v, 1] D + b`` (homogeneous) in the reference."""

    depth: F32  # [H, W]
    m: F64  # [3, 3]
    b: F64  # [3]


@dataclass(frozen=True)
class AlignParameters:
    """See ``cags_client.align.AlignSettings``; ``cell_px`` is client pixels a reference pixel."""

    cell_px: tuple[float, float]
    stride: int
    """Every ``stride``-th pixel of every ``stride``-th row may hide others."""
    depth_tolerance: float
    slope_cells: float
    border_px: float
    erosion_radius: int
    erosion_iterations: int
    threads: int


@dataclass(frozen=True)
class CorrectParameters:
    """See ``cags_client.restore.affine.AffineSettings``."""

    radius_cells: int
    gain_prior: float
    fine_noise: tuple[float, float, float]
    broad_noise: tuple[float, float, float]
    """See ``cags_common.video.noise.CodingNoise``."""
    block_px: int
    misregistration: float
    threads: int
    veil: float = 1.0
    """In [0, 1]: see ``cags_client.restore.RestoreInput``."""


@dataclass(frozen=True)
class CarryParameters:
    """See ``cags_client.carry``."""

    radius_px: int
    caution: float
    plausible: float
    """Times the usual power of a correction: what is too much."""
    visible_power: float
    threads: int


@dataclass(frozen=True, eq=False)
class AlignedImage:
    """What :func:`align` fills; shapes are the depth's."""

    confidence: F32  # [H, W]
    occluded: NDArray[np.bool_]  # [H, W]
    rgb: F32 | None  # [H, W, 3], where it was asked for


FIELD_CHANNELS = 4
"""Factor, and offsets of red, green and blue."""

_buffers = BufferPool()


def align(reference: F32, view: Reprojection, p: AlignParameters, *, colours: bool) -> AlignedImage:
    """What a ``reference`` [h, w, 3] shows of a view, with its ``colours`` or without. Raises ``KernelError``."""
    shape = view.depth.shape
    rgb = _buffers.empty((*shape, 3)) if colours else None
    image = AlignedImage(_buffers.empty(shape), _buffers.empty_mask(shape), rgb)
    reference, depth = _checked(reference, (*reference.shape[:2], 3)), _checked(view.depth, shape)
    given = _AlignInput(
        _reprojection(view, depth, reference),
        _address(reference),
        *(*p.cell_px, p.stride, p.depth_tolerance, p.slope_cells, p.border_px),
        *(p.erosion_radius, p.erosion_iterations, p.threads),
    )
    wanted = _AlignOutput(_address(image.confidence), _address(image.occluded), _address(image.rgb))
    check(library().cags_align(ctypes.byref(given), ctypes.byref(wanted)), "align")
    return image


def fields(own: F32, reference: F32, parameters: CorrectParameters) -> F32:
    """Factors and offsets [h, w, 4] of the correction of ``own`` by ``reference`` [h, w, 3], in their view.

    Raises ``KernelError`` and, for arrays that do not fit, ``ValueError``.
    """
    own, reference = _checked(own, (*reference.shape[:2], 3)), _checked(reference, (*reference.shape[:2], 3))
    height, width = reference.shape[:2]
    nowhere = _Reprojection(None, width, height, width, height)
    given = _correct_input(nowhere, own, reference, parameters)
    out = _buffers.empty((height, width, FIELD_CHANNELS))
    check(library().cags_fields(ctypes.byref(given), _address(out)), "fields")
    return out


def correct(
    own: F32,
    reference: F32,
    view: Reprojection,
    parameters: CorrectParameters,
    *,
    distorted: F32,
    confidence: F32,
    fields: F32 | None = None,
) -> F32:
    """``distorted`` [H, W, 3] corrected by ``fields`` [h, w, 4] where ``confidence`` [H, W] is; in [0, 1].

    Without ``fields`` those of :func:`fields` are used. ``own`` and ``reference`` are [h, w, 3].

    Raises ``KernelError`` and, for arrays that do not fit, ``ValueError``.
    """
    height, width = view.depth.shape
    own, reference = _checked(own, (*reference.shape[:2], 3)), _checked(reference, (*reference.shape[:2], 3))
    distorted, confidence = _checked(distorted, (height, width, 3)), _checked(confidence, (height, width))
    depth = _checked(view.depth, (height, width))
    made = None if fields is None else _checked(fields, (*reference.shape[:2], FIELD_CHANNELS))
    given = _correct_input(_reprojection(view, depth, reference), own, reference, parameters)
    given.fields, given.distorted, given.confidence = (_address(a) for a in (made, distorted, confidence))
    restored = _buffers.empty((height, width, 3))
    check(library().cags_correct(ctypes.byref(given), _address(restored)), "correct")
    return restored


def carry(reference: F32, then: F32, now: F32, parameters: CarryParameters) -> F32:
    """``reference`` [h, w, 3] carried to another frame, by the client's own views of both; in [0, 1].

    Raises ``KernelError`` and, for arrays that do not fit, ``ValueError``.
    """
    height, width = reference.shape[:2]
    pictures = [_checked(picture, (height, width, 3)) for picture in (reference, then, now)]
    p = parameters
    given = _CarryInput(
        *map(_address, pictures),
        *(width, height, p.radius_px, p.caution, p.plausible, p.visible_power, p.threads),
    )
    out = _buffers.empty((height, width, 3))
    check(library().cags_carry(ctypes.byref(given), _address(out)), "carry")
    return out


def lay(shown: F32, over: F32, share: F32, confidence: F32, threads: int) -> None:
    """Change ``shown`` [H, W, 3] towards ``over`` [H, W, 3] by ``share`` times ``confidence`` [H, W], in place.

    ``shown`` and ``share`` may be parts of larger pictures. Raises ``KernelError`` and, for arrays that do not fit,
    ``ValueError``.
    """
    if share.ndim != 2 or share.dtype != np.float32 or shown.dtype != np.float32 or not shown.flags.writeable:
        raise ValueError(f"shown of {shown.dtype} and share of {share.dtype}, {share.shape}; float32 and [H, W] needed")
    height, width = share.shape
    over, confidence = _checked(over, (height, width, 3)), _checked(confidence, (height, width))
    if shown.shape != over.shape or shown.strides[1:] != (12, 4) or share.strides[1] != 4:
        raise ValueError(f"array of shape {shown.shape}, expected {over.shape} in whole rows")
    pitches = share.strides[0] // 4, shown.strides[0] // 4
    given = _LayInput(_address(over), _address(share), _address(confidence), *pitches, width, height, threads)
    check(library().cags_lay(ctypes.byref(given), _address(shown)), "lay")


def _correct_input(view: _Reprojection, own: F32, reference: F32, p: CorrectParameters) -> _CorrectInput:
    return _CorrectInput(
        view=view,
        own=_address(own),
        reference=_address(reference),
        radius_cells=p.radius_cells,
        gain_prior=p.gain_prior,
        fine_noise=(_float * 3)(*p.fine_noise),
        broad_noise=(_float * 3)(*p.broad_noise),
        block_px=p.block_px,
        misregistration=p.misregistration,
        veil=p.veil,
        threads=p.threads,
    )


def _reprojection(view: Reprojection, depth: F32, reference: F32) -> _Reprojection:
    if view.m.shape != (3, 3) or view.b.shape != (3,):
        raise ValueError(f"m of shape {view.m.shape} and b of shape {view.b.shape}, expected (3, 3) and (3,)")
    return _Reprojection(
        *(_address(depth), depth.shape[1], depth.shape[0], reference.shape[1], reference.shape[0]),
        (_float * 9)(*np.ravel(view.m)),
        (_float * 3)(*np.ravel(view.b)),
    )


def _checked(array: F32, shape: tuple[int, ...]) -> F32:
    if array.shape != shape:
        raise ValueError(f"array of shape {array.shape}, expected {shape}")
    return np.ascontiguousarray(array, dtype=np.float32)


def _address(array: NDArray[np.generic] | None) -> ctypes.c_void_p:
    return _Pointer(None if array is None else array.ctypes.data)
