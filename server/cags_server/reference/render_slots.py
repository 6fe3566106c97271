"""Whose reference is rendered when there are more to render than the renderer can: few wait for it, and all in turn.

A reference that waits behind a dozen others comes too late to be of use, and costs as much. So only as many are out as
will be done soon; a client that finds no place serves its frame by what it saw last, and goes first at its next one.
"""

from __future__ import annotations

from collections import OrderedDict

RENDERS_PER_WORKER = 2
"""Reference renders out for each worker: one that is being rendered and one to follow it."""

PATIENCE_US = 2_000_000
"""A client that has not come back for so long has lost its turn."""


class RenderSlots:
    """The places of one renderer, shared by all its clients."""

    def __init__(self, workers: int) -> None:
        self._places = RENDERS_PER_WORKER * workers
        self._out = 0
        self._turned_away: OrderedDict[str, int] = OrderedDict()  # client -> when, the longest ago first

    def may(self, name: str, now_us: int) -> bool:
        """Whether a client may have a reference rendered now; one that may not goes before those not turned away."""
        while self._turned_away and next(iter(self._turned_away.values())) < now_us - PATIENCE_US:
            self._turned_away.popitem(last=False)
        first = list(self._turned_away)[: max(self._places - self._out, 0)]
        if name in first or len(first) < self._places - self._out:
            return True
        self._turned_away.setdefault(name, now_us)
        return False

    def begun(self, name: str) -> None:
        """A client's reference is being rendered, or waits for a worker."""
        self._out += 1
        self._turned_away.pop(name, None)

    def ended(self) -> None:
        """A reference render came back, or was given up."""
        self._out -= 1

    def left(self, name: str) -> None:
        """A client is gone."""
        self._turned_away.pop(name, None)
