"""The rasteriser's C interface: numpy arrays in and out, nothing copied, the GIL released while a call runs.

Callers validate their data (finite values, quaternions of non-zero norm): ``cags_common.raster`` does.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cags_kernels.buffers import BufferPool
from cags_kernels.library import check, fields, library, native, sized

F32: TypeAlias = NDArray[np.float32]
F64: TypeAlias = NDArray[np.float64]

_Pointer = ctypes.c_void_p
_int32, _int64, _float, _double = ctypes.c_int32, ctypes.c_int64, ctypes.c_float, ctypes.c_double

FAST, BALANCED, EXACT = 0, 1, 2
DEPTH_NONE, DEPTH_EXPECTED = 0, 1

BRIGHTEST = float(np.finfo(np.float32).max)

MAX_SIDE_PX = 16384

SPLAT_SHAPES: dict[str, tuple[int, ...]] = {
    "means": (3,),
    "quats": (4,),
    "log_scales": (3,),
    "logit_opacities": (),
    "sh0": (3,),
    "sh_rest": (3,),
}
"""Columns of each array per splat; those of ``sh_rest`` per coefficient."""

_pictures = BufferPool()


@native("CagsSplats")
class _Splats(ctypes.Structure):
    _fields_ = [
        ("count", _int64),
        ("sh_rest_count", _int32),
        *((name, _Pointer) for name in SPLAT_SHAPES),
        ("lengths", _int64 * len(SPLAT_SHAPES)),
    ]


@native("CagsCamera")
class _Camera(ctypes.Structure):
    _fields_ = [
        ("rotation", _double * 9),
        ("position", _double * 3),
        *((name, _double) for name in ("fx", "fy", "cx", "cy", "near_plane")),
        ("width", _int32),
        ("height", _int32),
    ]


@native("CagsRasterOptions")
class _Options(ctypes.Structure):
    _fields_ = [(name, _float) for name in ("dilation", "filter", "void_alpha", "brightest")] + [
        (name, _int32) for name in ("exactness", "depth", "max_sh_degree", "threads")
    ]


@native("CagsRasterTargets")
class _Targets(ctypes.Structure):
    _fields_ = [
        *((name, _Pointer) for name in ("rgb", "alpha", "depth", "contribution")),
        ("lengths", _int64 * 4),
    ]


@native("CagsRasterStatistics")
class _Statistics(ctypes.Structure):
    _fields_ = [(name, _double) for name in ("project_ms", "bin_ms", "tiles_ms")] + [
        (name, _int64) for name in ("visible", "entries", "block_visits")
    ]


@dataclass(frozen=True)
class RasterCamera:
    """A pinhole camera: ``rotation`` [3, 3] world to camera, ``position`` [3] in the world, pixels centred at + 0.5."""

    rotation: F64
    position: F64
    fx: float
    fy: float
    cx: float
    cy: float
    near: float
    width: int
    height: int


@dataclass(frozen=True)
class RasterOptions:
    """``cags_common.raster.RenderOptions`` as numbers; variances in squared pixels."""

    dilation: float
    filter: float
    void_alpha: float
    exactness: int
    depth: int
    max_sh_degree: int
    threads: int
    brightest: float = BRIGHTEST
    """Upper limit of colours."""


@dataclass(frozen=True)
class RasterStatistics:
    """Times and amounts of work of one frame."""

    project_ms: float
    bin_ms: float
    tiles_ms: float
    visible: int
    """Splats that touch the image."""
    entries: int
    """Pairs of a splat and a tile of 32x32 pixels."""
    block_visits: int
    """Pairs of a splat and a block of 4x4 pixels that were blended."""


@dataclass(frozen=True, eq=False)
class RasterImage:
    """Output arrays of :meth:`NativeScene.render`; None for those that were not requested."""

    rgb: F32  # [H, W, 3]
    alpha: F32  # [H, W]
    depth: F32 | None  # [H, W]
    contribution: F32 | None  # [N]
    statistics: RasterStatistics


class NativeScene:
    """Splats held by the native library. Renders may run concurrently; an update must not run during a render.

    ``splats`` is the six arrays means [N, 3], quats [N, 4], log_scales [N, 3], logit_opacities [N], sh0 [N, 3] and
    sh_rest [N, K, 3], all finite; they are copied. Raises :class:`cags_kernels.KernelError`.
    """

    def __init__(self, splats: tuple[F32, ...], threads: int = 1) -> None:
        self._library = library()
        self._handle = _Pointer()
        self._buffers = BufferPool()
        given = _splats(splats)
        self.count, self._coefficients = len(splats[0]), splats[5].shape[1]
        create = self._library.cags_raster_scene_create
        check(create(ctypes.byref(given), threads, ctypes.byref(self._handle)), "raster_scene_create")

    def __del__(self) -> None:
        handle = getattr(self, "_handle", None)
        if handle:
            self._library.cags_raster_scene_destroy(handle)

    def update(self, rows: NDArray[np.int64], splats: tuple[F32, ...], threads: int = 1) -> None:
        """Take the splats at ascending ``rows`` [M] from ``splats``, arrays [N] of the whole scene.

        Raises :class:`cags_kernels.KernelError` if a splat cannot be drawn; the scene is then unchanged.
        """
        self._change("raster_scene_update", rows, splats, threads)

    def move(self, rows: NDArray[np.int64], splats: tuple[F32, ...], threads: int = 1) -> None:
        """The same of position, rotation and opacity; their other attributes must equal those of the scene."""
        self._change("raster_scene_move", rows, splats, threads)

    def _change(self, call: str, rows: NDArray[np.int64], splats: tuple[F32, ...], threads: int) -> None:
        given, count, coefficients = _splats(splats), len(splats[0]), splats[5].shape[1]
        if rows.ndim != 1 or not np.issubdtype(rows.dtype, np.integer):
            raise ValueError(f"rows of shape {rows.shape} and type {rows.dtype}")
        if len(rows) and not 0 <= int(rows.min()) <= int(rows.max()) < self.count:
            raise ValueError(f"rows {int(rows.min())} to {int(rows.max())} of a scene of {self.count}")
        if (count, coefficients) != (self.count, self._coefficients):
            raise ValueError(f"{count} splats of {coefficients} coefficients for a scene of {self.count}")
        rows = np.ascontiguousarray(rows, dtype=np.int64)
        change = getattr(self._library, f"cags_{call}")
        check(change(self._handle, *sized(rows), ctypes.byref(given), threads), call)

    def render(self, camera: RasterCamera, options: RasterOptions, *, contribution: bool = False) -> RasterImage:
        """Render one view over black, with depth of kind ``options.depth``."""
        shape = _size(camera.width, camera.height)
        rgb, alpha = self._buffers.empty((*shape, 3)), self._buffers.empty(shape)
        depth = None if options.depth == DEPTH_NONE else self._buffers.empty(shape)
        weights = self._buffers.empty((self.count,)) if contribution else None
        targets = _targets(rgb, alpha, depth, weights)
        statistics = _Statistics()
        status = self._library.cags_raster_render(
            self._handle, *_arguments(camera, options), ctypes.byref(targets), ctypes.byref(statistics)
        )
        check(status, "raster_render")
        figures = (getattr(statistics, name) for name, *_ in _Statistics._fields_)
        return RasterImage(rgb, alpha, depth, weights, RasterStatistics(*figures))


def enlarge(picture: F32, width: int, height: int, threads: int) -> F32:
    """Enlarge ``picture`` [(height + 1) // 2, (width + 1) // 2, 3] to [height, width, 3] by cubic convolution.

    Both in [0, 1]. Raises ``KernelError`` and, for a picture of another size, ``ValueError``.
    """
    _size(width, height)
    if picture.shape != (*_half_shape(width, height), 3):
        raise ValueError(f"picture of shape {picture.shape} is not half of {width}x{height} px")
    half, whole = np.ascontiguousarray(picture, np.float32), _pictures.empty((height, width, 3))
    sizes = _int32(width), _int32(height), _int32(threads)
    check(library().cags_enlarge(*sized(half), *sizes, *sized(whole)), "enlarge")
    return whole


def _size(width: int, height: int) -> tuple[int, int]:
    """(height, width) of a picture. Raises ``ValueError``."""
    if not (1 <= width <= MAX_SIDE_PX and 1 <= height <= MAX_SIDE_PX):
        raise ValueError(f"a picture of {width}x{height} px; sides have 1 to {MAX_SIDE_PX}")
    return height, width


def _half_shape(width: int, height: int) -> tuple[int, int]:
    return (height + 1) // 2, (width + 1) // 2


def _splats(arrays: tuple[F32, ...]) -> _Splats:
    if len(arrays) != len(SPLAT_SHAPES):
        raise ValueError(f"{len(arrays)} splat arrays, expected {len(SPLAT_SHAPES)}")
    means, rest = arrays[0], arrays[5]
    for array, (name, shape) in zip(arrays, SPLAT_SHAPES.items(), strict=True):
        if array.dtype != np.float32 or not array.flags.c_contiguous:
            raise ValueError(f"{name}: splat arrays must be C-contiguous float32")
        coefficients = rest.shape[1:2] if name == "sh_rest" else ()
        if array.shape != (*means.shape[:1], *coefficients, *shape):
            raise ValueError(f"{name} of shape {array.shape} for {len(means)} splats")
    return _Splats(len(means), rest.shape[1], *fields(*arrays))


def _targets(*arrays: F32 | None) -> _Targets:
    return _Targets(*fields(*arrays))


def _arguments(camera: RasterCamera, options: RasterOptions) -> tuple[object, object]:
    if np.shape(camera.rotation) != (3, 3) or np.shape(camera.position) != (3,):
        raise ValueError(f"a rotation of {np.shape(camera.rotation)} and a position of {np.shape(camera.position)}")
    native_camera = _Camera(
        (_double * 9)(*np.ravel(camera.rotation)),
        (_double * 3)(*np.ravel(camera.position)),
        *(camera.fx, camera.fy, camera.cx, camera.cy, camera.near, camera.width, camera.height),
    )
    native_options = _Options(
        *(options.dilation, options.filter, options.void_alpha, options.brightest),
        *(options.exactness, options.depth, options.max_sh_degree, options.threads),
    )
    return ctypes.byref(native_camera), ctypes.byref(native_options)
