"""How long each stage of a frame takes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager


class Stopwatch:
    """Times named stages by a clock that was passed in (seconds)."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self.stages_ms: dict[str, float] = {}

    def __call__(self, stage: str) -> AbstractContextManager[None]:
        """A context whose time is ``stage``'s."""
        return self._timed(stage)

    @contextmanager
    def _timed(self, stage: str) -> Iterator[None]:
        start = self._clock()
        yield
        self.stages_ms[stage] = (self._clock() - start) * 1e3
