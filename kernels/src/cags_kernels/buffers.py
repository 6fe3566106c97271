"""Image buffers that are used again once nobody holds them.

A fresh large array costs a page fault for every 4 KiB, milliseconds for a frame of 1600x1200. A :class:`Lease` owns a
block of memory while any array or view made of it lives; when the last one is gone the block goes back to its pool.
"""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

_KEPT = 12
"""Blocks kept in waiting: two or three frames' worth."""


_LINE_BYTES = 64
"""Of the processor's caches."""


class BufferPool:
    """Float32 arrays on recycled memory. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept = _KEPT  # module names may be gone when the interpreter ends and the last arrays come back
        self._waiting: list[NDArray[np.float32]] = []

    def empty(self, shape: tuple[int, ...]) -> NDArray[np.float32]:
        """An uninitialised array, as by ``numpy.empty``."""
        size = int(np.prod(shape))
        return np.asarray(Lease(self, self._take(size), shape))

    def _take(self, size: int) -> NDArray[np.float32]:
        with self._lock:
            for i, block in enumerate(self._waiting):
                if block.size == size:
                    return self._waiting.pop(i)
        return _aligned(size)

    def give_back(self, block: NDArray[np.float32]) -> None:
        """Take a block back; the oldest waiting one is freed when there are too many."""
        with self._lock:
            self._waiting.append(block)
            del self._waiting[: -self._kept]


def _aligned(size: int) -> NDArray[np.float32]:
    """``size`` uninitialised values from a cache line's boundary on: large pictures are written line by line."""
    memory = np.empty(size + _LINE_BYTES // 4, np.float32)
    skipped = -memory.ctypes.data % _LINE_BYTES // 4
    return memory[skipped : skipped + size]


class Lease:
    """What the arrays of one block hold on to. numpy makes it the base of the array it describes."""

    def __init__(self, pool: BufferPool, block: NDArray[np.float32], shape: tuple[int, ...]) -> None:
        self._pool, self._block = pool, block
        self.__array_interface__: dict[str, Any] = {**block.__array_interface__, "shape": shape}

    def __del__(self) -> None:
        self._pool.give_back(self._block)
