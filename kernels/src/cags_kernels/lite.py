"""The C interface of the network ``lite`` (``cags_client.restore.networks.lite``): numpy arrays in and out."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cags_kernels.buffers import BufferPool
from cags_kernels.library import check, library

F32: TypeAlias = NDArray[np.float32]

_Pointer, _int32, _float = ctypes.c_void_p, ctypes.c_int32, ctypes.c_float

WIDTH = 24
SEEN = 40
ANSWER = 16
"""Channels inside, of a block of 2 x 2 pixels going in, and coming out: the only ones that are compiled."""

ALIGNMENT_BYTES = 64

_TO_DOMAIN = np.array(
    [
        [1 / 4, 0, 0],
        [-1 / 6, -1 / 6, -1 / 6],
        [-1 / 6, 1 / 6, -1 / 6],
        [1 / 24, 1 / 12, 1 / 6],
        [1 / 24, -1 / 12, 1 / 6],
        [0, 0, 1],
    ]
)
"""Of F(4, 3) with the points 0, +-1, +-2 and infinity (Lavin and Gray 2016); the other matrices are in the kernel."""

_buffers = BufferPool()


class _LiteInput(ctypes.Structure):
    _fields_ = [
        *((name, _Pointer) for name in ("own", "reference", "fields")),
        *((name, _int32) for name in ("width", "height")),
        *((name, _Pointer) for name in ("head", "head_bias", "body", "body_bias", "tail", "tail_bias")),
        ("layers", _int32),
        *((name, _float) for name in ("factor_reach", "colour_reach")),
        ("threads", _int32),
    ]


@dataclass(frozen=True, eq=False)
class LiteWeights:
    """As a network of PyTorch holds them: linear [out, in], convolutions [out, in, 3, 3]."""

    head: F32  # [24, 40]
    head_bias: F32  # [24]
    noise: F32  # [24, 6]
    body: F32  # [layers, 24, 24, 3, 3]; an even number of layers
    body_bias: F32  # [layers, 24]
    tail: F32  # [16, 24, 3, 3]
    tail_bias: F32  # [16]

    def __post_init__(self) -> None:
        layers = len(self.body)
        if layers % 2:
            raise ValueError(f"a body of {layers} layers, expected an even number")
        wanted = {
            "head": (WIDTH, SEEN),
            "head_bias": (WIDTH,),
            "noise": (WIDTH, 6),
            "body": (layers, WIDTH, WIDTH, 3, 3),
            "body_bias": (layers, WIDTH),
            "tail": (ANSWER, WIDTH, 3, 3),
            "tail_bias": (ANSWER,),
        }
        for name, shape in wanted.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} of shape {getattr(self, name).shape}, expected {shape}")


@dataclass(frozen=True)
class LiteRun:
    """How far the network may move the factor and the correction, in displayed range and above 0, and its threads."""

    factor_reach: float
    colour_reach: float
    threads: int


class LiteKernel:
    """A network that is ready to run. Thread-safe."""

    def __init__(self, weights: LiteWeights) -> None:
        self._weights = weights
        self._head = _aligned(weights.head.T)
        self._body, self._body_bias = _aligned(_to_domain(weights.body)), _aligned(weights.body_bias)
        self._tail, self._tail_bias = _aligned(_to_domain(weights.tail)), _aligned(weights.tail_bias)

    def run(self, own: F32, reference: F32, fields: F32, noise: F32, how: LiteRun) -> F32:
        """Fields [h, w, 4] in place of ``fields``; ``own`` and ``reference`` are [h, w, 3] with h and w even.

        ``noise`` [6] are the features that the network takes.

        Raises ``KernelError`` and, for arrays that do not fit, ``ValueError``.
        """
        height, width = fields.shape[:2]
        wanted = {3: (own, reference), 4: (fields,)}
        images = [_checked(image, (height, width, lanes)) for lanes, group in wanted.items() for image in group]
        bias = _aligned(self._weights.head_bias + self._weights.noise @ _checked(noise, (6,)))
        weights = (self._head, bias, self._body, self._body_bias, self._tail, self._tail_bias)
        given = _LiteInput(
            *map(_address, images),
            *(width, height),
            *map(_address, weights),
            *(len(self._body_bias), how.factor_reach, how.colour_reach, how.threads),
        )
        improved = _buffers.empty((height, width, 4))
        check(library().cags_lite(ctypes.byref(given), _address(improved)), "lite")
        return improved


def _to_domain(kernels: F32) -> F32:
    """[..., out, in, 3, 3] -> [..., 36, in, out]."""
    places = np.einsum("yj,...oijk,xk->...yxio", _TO_DOMAIN, kernels.astype(np.float64), _TO_DOMAIN)
    return np.asarray(places.reshape(*kernels.shape[:-4], 36, *places.shape[-2:]), dtype=np.float32)


def _aligned(array: F32) -> F32:
    """A copy in one piece that begins on a cache line."""
    memory = np.empty(array.nbytes + ALIGNMENT_BYTES, np.uint8)
    start = -memory.ctypes.data % ALIGNMENT_BYTES
    copy: F32 = np.ndarray(array.shape, np.float32, memory.data, start)
    copy[...] = array
    return copy


def _checked(array: F32, shape: tuple[int, ...]) -> F32:
    if array.shape != shape:
        raise ValueError(f"array of shape {array.shape}, expected {shape}")
    return np.ascontiguousarray(array, dtype=np.float32)


def _address(array: F32) -> ctypes.c_void_p:
    return _Pointer(array.ctypes.data)
