"""Who waits to be let in, by address: one too many costs a place of the address that takes most of them."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Hashable
from typing import Generic, TypeVar

T = TypeVar("T", bound=Hashable)


class WaitingList(Generic[T]):
    """Things that wait, each from an address, oldest first."""

    def __init__(self) -> None:
        self._by_peer: dict[str, OrderedDict[T, float]] = {}  # since when, seconds
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, peer: str, item: T) -> None:
        """It waits from now on."""
        self.discard(peer, item)
        self._by_peer.setdefault(peer, OrderedDict())[item] = time.monotonic()
        self._count += 1

    def discard(self, peer: str, item: T) -> None:
        """It does not wait any more, if it did."""
        of_peer = self._by_peer.get(peer)
        if of_peer is None or of_peer.pop(item, None) is None:
            return
        self._count -= 1
        if not of_peer:
            del self._by_peer[peer]

    def first_to_go(self) -> T | None:
        """The oldest of the address with most of them; None where nothing waits."""
        most = max(self._by_peer.values(), key=len, default=None)
        return None if most is None else next(iter(most))

    def longer_than(self, seconds: float) -> list[T]:
        """The items that have waited for more than ``seconds``."""
        limit_s, late = time.monotonic() - seconds, list[T]()
        for of_peer in self._by_peer.values():
            for item, since_s in of_peer.items():
                if since_s >= limit_s:
                    break
                late.append(item)
        return late
