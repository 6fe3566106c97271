"""Times between media frames at which a display shows what moves: motion is known at any time, not at frames alone.

Nothing is asked of the server for them. A picture between two frames is drawn only where the next media frame will not
be late for it. Whether there are any, and how densely, :mod:`cags_client.playback.quality` decides.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

LEAST_SHARE = 0.25
"""Of the time between two pictures: closer to a media frame, one that is drawn for itself is as good."""


@dataclass(frozen=True, slots=True)
class Moment:
    """A time to draw for: ``share`` media frames after the one that was drawn last."""

    due_us: int
    share: float


@dataclass(frozen=True, slots=True)
class _Span:
    """From the frame on display to the next, ``frames`` later, in steps."""

    first_us: int
    end_us: int
    frames: int
    step_us: float

    def due_us(self, steps: int) -> int | None:
        """When the picture after so many steps is due; None: too close to the next frame."""
        due_us = self.first_us + round(steps * self.step_us)
        return due_us if due_us <= self.end_us - LEAST_SHARE * self.step_us else None


class Interpolation:
    """Schedules the interpolated pictures of one play."""

    def __init__(self) -> None:
        self._span: _Span | None = None
        self._done = 0  # steps since the frame on display

    def begin(self, due_us: int, next_due_us: int, frames: int, step_us: float) -> None:
        """A media frame due at ``due_us`` is drawn; the next, ``frames`` later, is due at ``next_due_us``.

        Between them pictures are due every ``step_us``.
        """
        self._span, self._done = _Span(due_us, next_due_us, frames, step_us), 0

    def cancel(self) -> None:
        """Nothing is drawn before what comes next."""
        self._span = None

    def next_us(self) -> int | None:
        """When the next picture is due; None: none is before the next media frame."""
        return None if self._span is None else self._span.due_us(self._done + 1)

    def take(self, now_us: int, fits: Callable[[int, float], bool]) -> Moment | None:
        """The newest picture that is due, if it is done before the next media frame: ``fits(now_us, due_us)``."""
        span, next_us = self._span, self.next_us()
        if span is None or next_us is None or now_us < next_us:
            return None
        self._done = max(int((now_us - span.first_us) / span.step_us), self._done + 1)
        due_us = span.due_us(self._done)
        if due_us is None or not fits(now_us, span.end_us):
            self._span = None
            return None
        return Moment(due_us, (due_us - span.first_us) / (span.end_us - span.first_us) * span.frames)
