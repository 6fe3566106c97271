"""Values that were used of late, up to a number of bytes."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable, Iterator
from typing import Generic, TypeVar

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class Recent(Generic[K, V]):
    """Keeps values until others were used more recently and ``max_bytes`` are full. Not thread-safe.

    Media is played in loops: bounded by a number of frames, a clip with one frame more would be made anew every time.
    The newest values stay whatever their size, which caches that refuse a value larger than themselves (``cachetools``)
    would not keep.
    """

    def __init__(self, max_bytes: int, *, least: int = 1) -> None:
        """The ``least`` newest values stay, however large they are."""
        self._max_bytes, self._least = max_bytes, least
        self._values: OrderedDict[K, tuple[V, int]] = OrderedDict()
        self.bytes = 0
        """Bytes of all values kept."""

    def get(self, key: K) -> V | None:
        """The value of ``key``, which counts as used now; None where there is none."""
        found = self._values.get(key)
        if found is None:
            return None
        self._values.move_to_end(key)
        return found[0]

    def put(self, key: K, value: V, size_bytes: int) -> None:
        """Keep ``value``, and forget what was not used for longest."""
        _, before = self._values.pop(key, (None, 0))
        self._values[key] = value, size_bytes
        self.bytes += size_bytes - before
        while self.bytes > self._max_bytes and len(self._values) > self._least:
            self.bytes -= self._values.popitem(last=False)[1][1]

    def drop(self, key: K) -> None:
        """Forget the value of ``key``, if there is one."""
        _, size_bytes = self._values.pop(key, (None, 0))
        self.bytes -= size_bytes

    def clear(self) -> None:
        """Forget everything."""
        self._values.clear()
        self.bytes = 0

    def __contains__(self, key: object) -> bool:
        """Whether there is a value of ``key``, which does not count as used by that."""
        return key in self._values

    def __iter__(self) -> Iterator[K]:
        """Keys, the one that was not used for longest first."""
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)
