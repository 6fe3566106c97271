"""Which media frame is displayed when, by the client's clock."""

from __future__ import annotations

from dataclasses import dataclass, replace

from cags_protocol.wire.messages import Control


@dataclass(frozen=True, slots=True)
class Timeline:
    """Frame ``frame`` is displayed at ``at_us`` (client clock), the others at the frame rate times ``rate``.

    Frames are counted from ``frame`` by *ticks*: with ``loop`` the media starts again after its last frame.
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
        return self.at_us + round(tick * self.period_us)

    def media_frame(self, tick: int) -> int | None:
        """Media frame of ``tick``, None past the end."""
        frame = self.frame + tick
        if frame < self.frames:
            return frame
        return frame % self.frames if self.loop else None
