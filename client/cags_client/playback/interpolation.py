"""Times between media frames at which a display shows what moves: motion is known at any time, not at frames alone.

Nothing is asked of the server for them. A picture between two frames is drawn only where the next media frame will not
be late for it.
"""

from __future__ import annotations

from dataclasses import dataclass

from cags_client.settings import AUTO, OFF

CAUTION = 1.25
"""The time that a picture is taken to need, in those that the last ones took."""

MEMORY = 0.2
"""Weight of the newest picture in what pictures are taken to need."""

LEAST_SHARE = 0.25
"""Of a display's period: closer to a media frame, one that is drawn for itself is as good."""


@dataclass(frozen=True, slots=True)
class Moment:
    """A time to draw for: ``share`` media frames after the one that was drawn last."""

    due_us: int
    share: float


class Interpolation:
    """Schedules the interpolated pictures of one play."""

    def __init__(self, mode: str, display_rate: float) -> None:
        """``mode`` is off, on or auto (where there is time), ``display_rate`` in pictures a second."""
        self._mode, self._period_us = mode, 1e6 / display_rate
        self._span: tuple[int, int, int] | None = None  # due times of the frame on display and of the next, and how far
        self._done = 0  # periods since the frame on display
        self._begun_us: int | None = None
        self._takes_us = 0.0

    def begin(self, due_us: int, next_due_us: int, frames: int) -> None:
        """A media frame due at ``due_us`` is drawn; the next, ``frames`` later, is due at ``next_due_us``."""
        self._span, self._done = None if self._mode == OFF or frames < 1 else (due_us, next_due_us, frames), 0

    def cancel(self) -> None:
        """What comes next is not known: nothing is drawn before it."""
        self._span = None

    def next_us(self) -> int | None:
        """When the next picture is due; None: none is before the next media frame."""
        if self._span is None:
            return None
        due_us = self._span[0] + round((self._done + 1) * self._period_us)
        return due_us if due_us <= self._span[1] - LEAST_SHARE * self._period_us else None

    def take(self, now_us: int) -> Moment | None:
        """The newest picture that is due, where there is time for it."""
        if self._span is None or (next_us := self.next_us()) is None or now_us < next_us:
            return None
        first_us, end_us, frames = self._span
        self._done = max(int((now_us - first_us) / self._period_us), self._done + 1)
        due_us = first_us + round(self._done * self._period_us)
        enough = now_us + CAUTION * self._takes_us <= end_us
        if due_us > end_us - LEAST_SHARE * self._period_us or (self._mode == AUTO and not enough):
            self._span = None
            return None
        return Moment(due_us, (due_us - first_us) / (end_us - first_us) * frames)

    def drawing(self, now_us: int) -> None:
        """A picture, of a media frame or between two, is begun."""
        self._begun_us = now_us

    def drawn(self, now_us: int) -> None:
        """The picture that was begun is finished."""
        if self._begun_us is not None:
            took_us = now_us - self._begun_us
            self._takes_us += (MEMORY if self._takes_us else 1.0) * (took_us - self._takes_us)
            self._begun_us = None
