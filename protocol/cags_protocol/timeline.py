"""Which media frame is displayed when, by the client's clock: the same sum on both sides.

Each :class:`~cags_protocol.wire.messages.Control` makes a new timeline, and frames are counted from the one that it
names by *ticks*: tick 0 is that frame, and ticks go on through every loop. Ticks before 0 are those of a client that
has not come to it yet.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import floor

from cags_protocol.wire.messages import Control


@dataclass(frozen=True, slots=True)
class Timeline:
    """Frame ``frame`` is displayed at ``at_us`` (client clock), the others at the frame rate times ``rate``.

    With ``loop`` the media starts again after its last frame. While it is not ``playing``, every tick displays
    ``frame``.
    """

    fps: float
    frames: int
    frame: int = 0
    at_us: int = 0
    rate: float = 1.0
    playing: bool = False
    loop: bool = False

    def controlled(self, control: Control) -> Timeline:
        """The timeline that ``control`` asks for. A frame beyond the end is the last one."""
        frame = min(control.frame, self.frames - 1)
        playing = {"play": True, "pause": False}.get(control.action, self.playing)
        return replace(self, frame=frame, at_us=control.at_us, rate=control.rate, playing=playing, loop=control.loop)

    @property
    def period_us(self) -> float:
        """Time between two frames."""
        return 1e6 / (self.fps * self.rate)

    def display_us(self, tick: int) -> int:
        """When the frame of ``tick`` is displayed."""
        return self.at_us + round(tick * 1e6 / (self.fps * self.rate))

    def first_tick(self, from_us: int) -> int:
        """The first tick that is displayed at ``from_us`` or later."""
        tick = floor((from_us - self.at_us) / self.period_us) - 1  # rounded: it is this or one of the next
        while self.display_us(tick) < from_us:
            tick += 1
        return tick

    def media_frame(self, tick: int) -> int | None:
        """Media frame of ``tick``, None past the end."""
        frame = self.frame + tick
        if not self.playing:
            return self.frame
        if self.loop:
            return frame % self.frames
        return frame if frame < self.frames else None

    def round_end(self, tick: int) -> int:
        """The tick after the last frame of the round that ``tick`` is in: of the only one without ``loop``."""
        rounds = 1 + (self.frame + tick) // self.frames if self.loop else 1
        return rounds * self.frames - self.frame
