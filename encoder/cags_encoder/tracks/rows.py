"""Splats indexed by id, in arrays that grow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32
from cags_common.splats import Ids, Splats


def same_rows(a: Splats, b: Splats) -> NDArray[np.bool_]:
    """Whether row i [n] is bit-identical in both."""
    pairs = zip(a.arrays(), b.arrays(), strict=True)
    same: NDArray[np.bool_] = np.logical_and.reduce([same_bits(mine, other) for (_, mine), (_, other) in pairs])
    return same


def same_bits(a: F32, b: F32) -> NDArray[np.bool_]:
    """Whether row i [n] is bit-identical in both arrays [n, ...]."""
    columns = int(np.prod(a.shape[1:], dtype=int))
    bits = a.reshape(len(a), columns).view(np.uint32), b.reshape(len(b), columns).view(np.uint32)
    same: NDArray[np.bool_] = (bits[0] == bits[1]).all(axis=1)
    return same


def identical_rows(before: Splats, after: Splats) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pairs of rows of both frames whose splats are bit-identical; duplicates are paired in order."""
    mine, theirs = _keys(before), _keys(after)
    by_mine, by_theirs = np.argsort(mine, kind="stable"), np.argsort(theirs, kind="stable")
    mine, theirs = mine[by_mine], theirs[by_theirs]
    rank = np.arange(len(theirs)) - np.searchsorted(theirs, theirs)
    at = np.searchsorted(mine, theirs) + rank
    paired = (at < len(mine)) & (mine[np.minimum(at, len(mine) - 1)] == theirs)
    rows, others = by_mine[at[paired]], by_theirs[paired]
    same = same_rows(before.take(rows), after.take(others))
    return rows[same], others[same]


def _keys(splats: Splats) -> NDArray[np.uint64]:
    """64-bit hash of each splat's bits, without harmonics."""
    return bit_keys(*(array for name, array in splats.arrays() if name != "sh_rest"))


def bit_keys(*arrays: F32) -> NDArray[np.uint64]:
    """64-bit hash of the bits of row i [n] of all ``arrays`` [n, ...]."""
    keys = np.zeros(len(arrays[0]), np.uint64)
    for array in arrays:
        for column in np.ascontiguousarray(array).reshape(len(keys), -1).view(np.uint32).T:
            keys = (keys ^ column) * np.uint64(0x9E3779B97F4A7C15)
            keys ^= keys >> np.uint64(29)
    return keys


class SplatTable:
    """Splats indexed by id, and which ids are alive."""

    def __init__(self, first: Splats) -> None:
        self._arrays = {name: array.copy() for name, array in first.arrays()}
        self.alive: NDArray[np.bool_] = np.ones(len(first), bool)

    @property
    def capacity(self) -> int:
        """The largest id plus one."""
        return len(self.alive)

    def take(self, ids: Ids) -> Splats:
        """The splats with the given ``ids``."""
        return Splats(**{name: array[ids] for name, array in self._arrays.items()})

    def put(self, ids: Ids, splats: Splats) -> None:
        """Set the splats of ``ids`` and mark them as alive."""
        top = int(ids.max(initial=-1)) + 1
        if top > self.capacity:
            self._grow(top)
        for name, array in splats.arrays():
            self._arrays[name][ids] = array
        self.alive[ids] = True

    def set(self, column: str, ids: NDArray[np.integer], values: F32) -> None:
        """Set one ``column`` of ``ids``, which are known."""
        self._arrays[column][ids] = values

    def holds(self, ids: Ids) -> NDArray[np.bool_]:
        """Whether each of ``ids`` is alive."""
        out = np.zeros(len(ids), bool)
        known = ids < self.capacity
        out[known] = self.alive[ids[known]]
        return out

    def differs(self, ids: Ids, splats: Splats, columns: Sequence[str]) -> NDArray[np.bool_]:
        """Whether splat ``ids[i]`` differs from ``splats[i]`` in any bit of ``columns``; true for unknown ids."""
        out = np.ones(len(ids), bool)
        known = ids < self.capacity
        arrays = dict(splats.arrays())
        same = [same_bits(self._arrays[name][ids[known]], arrays[name][known]) for name in columns]
        out[known] = ~np.logical_and.reduce(same)
        return out

    def _grow(self, capacity: int) -> None:
        more = capacity - self.capacity
        for name, array in self._arrays.items():
            self._arrays[name] = np.concatenate([array, np.zeros((more, *array.shape[1:]), np.float32)])
        self.alive = np.concatenate([self.alive, np.zeros(more, bool)])
