"""What a play has counted, and how long each stage of a frame takes."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field

from cags_common.errors import DecodeError
from cags_common.runtime.rare_log import RareLog

MAX_NOTICES = 16
"""Number of notices to remember, the newest; and to log at once, after which there is one a second."""

log = logging.getLogger(__name__)


@dataclass(eq=False)
class PlayStats:
    """Counts over a whole play."""

    frames: int = 0
    """Media frames presented."""
    interpolated: int = 0
    """Pictures presented between them."""
    missed: int = 0
    """Presented without all of their data."""
    dropped: int = 0
    """Not presented because the one after was due already."""
    decode_errors: int = 0
    keyframe_requests: int = 0
    bytes_tiles: int = 0
    bytes_reference: int = 0
    bytes_other: int = 0
    """Codebooks and weights."""
    made_us: int = 0
    """When the session was begun."""
    first_byte_us: int | None = None
    last_byte_us: int = 0
    first_picture_us: int | None = None
    """When the first picture had been drawn, of a reference or of the first frame."""
    started_us: int | None = None
    """When the first frame was due."""
    reconnects: int = 0
    """Dropped connections that were taken up again."""
    away_us: int = 0
    """Time without a session, in all."""
    notices: deque[str] = field(default_factory=lambda: deque(maxlen=MAX_NOTICES))
    """What the viewer has been told, each once."""
    _told: RareLog = field(default_factory=lambda: RareLog(log, burst=MAX_NOTICES))

    def damaged(self, error: DecodeError) -> None:
        """Count a payload that did not decode, and log why."""
        self.decode_errors += 1
        self._told.write(logging.WARNING, "damaged", "%s", error)

    def notice(self, text: str) -> None:
        """Log a warning for the viewer, unless the same was logged before."""
        if text not in self.notices:
            self.notices.append(text)
            self._told.write(logging.WARNING, "notice", "%s", text)


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
