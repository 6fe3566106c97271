"""A player that the viewer steers: pause, play, seek, speed, loop, and a camera that moves while the clip stands still.

The state of play is a :class:`~cags_protocol.timeline.Timeline`. Every wish makes a new one and tells the server. A
seek waits until no decoding and no drawing is under way. Where the store cannot show the frame from what it holds, the
server is asked to hold there; when the frame has come whole, the clip goes on from it. So nothing is skipped, however
slow the link is. A loop of a clip that is kept whole goes on without a break: the server plans it ahead.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from cags_client.frame.presented import PresentedFrame
from cags_client.playback.jobs import Decode, DecodeResult, Present
from cags_client.playback.player import Player
from cags_client.playback.quality import next_due
from cags_common.geometry import Pose
from cags_protocol import events as ev
from cags_protocol.wire.messages import Control

SEEK_PATIENCE_US = 15_000_000
"""How long the old picture stays after a seek when the first frame does not come whole; then what there is is shown."""

JUMP_US = 1_000_000
"""An end of the clip that is later than that was slept through."""


class InteractivePlayer(Player):
    """Plays until :meth:`leave` or the end of ``settings.duration``; at the clip's end it starts again or holds."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        """As :class:`Player`."""
        self.playing, self.loop, self.rate = True, True, 1.0
        self.frame = 0
        """The media frame on display."""
        self._wanted_frame: int | None = None
        self._awaited: tuple[int, int] | None = None
        self._shown: tuple[Pose, tuple[str, ...]] | None = None  # of the newest picture: pose, and how it was drawn
        super().__init__(*arguments, **named)
        self.frame = self.settings.start_frame

    # ------------------------------------------------------------------------------------------------ viewer's wishes

    def pause(self, now_us: int) -> None:
        """Hold the frame on display; the camera still moves, and the frame still gains detail."""
        if self.playing:
            self.playing = False
            self._tell("pause", self.frame, now_us, now_us)

    def play(self, now_us: int) -> None:
        """Go on from the frame on display, or from the beginning when that is the last one."""
        if self.playing:
            return
        self.playing = True
        if self.stats.started_us is None:  # the play begins by itself, once the first frame has come
            return
        if self.frame >= self._last_frame:
            self._tell("play", self.frame, now_us, now_us)
            self.seek(0)
        elif self._awaited is None:  # else the server would play on meanwhile: it is told when what was sought is there
            self._tell("play", self.frame, now_us + self.settings.start_delay_ms * 1000, now_us)

    def seek(self, frame: int) -> None:
        """Go to ``frame`` as soon as what is under way has ended."""
        if self.stats.started_us is not None:
            self._wanted_frame = max(0, min(frame, self._last_frame))

    def set_rate(self, rate: float, now_us: int) -> None:
        """Change the speed from the next frame on."""
        self.rate = rate
        if self.stats.started_us is not None and self.playing and self._next_tick < self._end_tick:
            next_us = max(self._timeline.display_us(self._next_tick), now_us)
            self._tell("rate", self._media_frame(self._next_tick), next_us, now_us)

    def set_loop(self, on: bool, now_us: int) -> None:
        """Start again at the clip's end, or hold there."""
        if on != self.loop:
            self.loop = on
            self.set_rate(self.rate, now_us)  # tells the server in time, or not: the end looks at what it was told

    # --------------------------------------------------------------------------------------------------------- in time

    def next_timer_us(self) -> int | None:
        """See :meth:`Player.next_timer_us`."""
        if self._awaited is None or self.finished:
            return super().next_timer_us()
        times = (self._session.next_timer_us(), self._viewpoint.next_us, self._awaited[1])
        return min(t for t in times if t is not None)

    def handle_timer(self, now_us: int) -> None:
        """See :meth:`Player.handle_timer`."""
        super().handle_timer(now_us)
        started, duration = self.stats.started_us, self.settings.duration
        if started is not None and duration is not None and now_us - started >= duration * 1e6:
            self.leave(now_us)

    def next_action(self, now_us: int) -> Decode | Present | None:
        """See :meth:`Player.next_action`."""
        if self._wanted_frame is not None and self.pipeline is not None:
            if self._decode_queue.decoding or self._presenting:
                return None
            self._seek_now(self._wanted_frame, now_us)
        if self._awaited is not None and now_us >= self._awaited[1]:
            self._go_on(now_us)
        if self._awaited is None:
            return super().next_action(now_us)
        if self.pipeline is not None and (batch := self._decode_queue.take()):
            return Decode(batch, self.pipeline)
        return None

    def done(self, action: Decode | Present, result: DecodeResult | PresentedFrame, now_us: int) -> None:
        """See :meth:`Player.done`."""
        if isinstance(action, Decode):
            super().done(action, result, now_us)
            assert isinstance(result, DecodeResult)
            ended = {event.message.frame for event in action.events if isinstance(event, ev.FrameEnded)}
            if self._awaited is not None and self._awaited[0] in ended:  # later ones may have been on their way before
                self._go_on(now_us)
            return
        assert isinstance(result, PresentedFrame)
        self._presented(action, result, now_us)
        if not action.media:
            return
        if self.playing and self._wanted_frame is None and self._next_tick >= self._end_tick:
            self._at_end(now_us)

    # --------------------------------------------------------------------------------------------------------- details

    def _at_end(self, now_us: int) -> None:
        assert self.pipeline is not None
        told = self._timeline
        if not self.loop:
            self.pause(now_us)
        elif now_us - told.display_us(self._end_tick) > JUMP_US:  # the machine slept: no round is made up for
            self.seek(0)
        elif told.loop and told.rate == self.rate and 0 in self.pipeline.kept:
            self._end_tick = told.round_end(self._end_tick)
            self._due_us = told.display_us(next_due(self._next_tick, self._end_tick, self._quality.permille))
        else:
            self.seek(0)

    @property
    def _last_frame(self) -> int:
        return self._timeline.frames - 1

    def _ask_to_play(self, at_us: int, now_us: int) -> None:
        if self.playing:
            self._tell("play", self.settings.start_frame, at_us, now_us)
        else:
            self._tell("pause", self.frame, now_us, now_us)

    def _tell(self, action: str, frame: int, at_us: int, now_us: int, *, keeps: bool | None = None) -> None:
        """``keeps``: whether what is held does for ``frame``; None: as the store says now."""
        if self.stats.started_us is None:
            return
        if keeps is None:
            keeps = self.pipeline is not None and frame in self.pipeline.kept
        loop = self.loop and keeps and self.pipeline is not None and len(self.pipeline.kept) == self._timeline.frames
        self._control(Control(action, frame, at_us, self.rate, loop=loop, keeps=keeps), now_us)

    def _seek_now(self, frame: int, now_us: int) -> None:
        assert self.pipeline is not None
        self._wanted_frame = None
        keeps = frame in self.pipeline.kept
        if keeps:
            self.pipeline.jump(frame)
        else:
            self._decode_queue.clear()
            self.pipeline.reset(frame)
            self._forgot(frame)
        self.frame = frame
        self._tell("seek", frame, now_us, now_us, keeps=keeps)
        if self.playing:
            self._session.control(Control("pause", frame, now_us, self.rate, keeps=keeps), now_us=now_us)
        self._awaited = (frame, now_us + SEEK_PATIENCE_US)
        if self.pipeline.holds(frame):
            self._go_on(now_us)

    def _go_on(self, now_us: int) -> None:
        """The frame that was sought is there."""
        self._awaited = self._shown = None
        if self.playing:
            self._tell("play", self.frame, now_us + self.settings.start_delay_ms * 1000, now_us)
        else:
            self._due_us = now_us

    def _state_of_play(self, now_us: int) -> Control | None:
        """See :meth:`Player._state_of_play`; a frame that is held, or waited for, stays."""
        if self.stats.started_us is None:
            return None
        if self._awaited is not None or not self.playing:
            control = Control("pause", self.frame if self._awaited is None else self._awaited[0], now_us)
        else:
            going = super()._state_of_play(now_us)
            assert going is not None
            control = going
        keeps = self.pipeline is not None and control.frame in self.pipeline.kept
        return replace(control, rate=self.rate, loop=self._timeline.loop, keeps=keeps)

    def _present(self, now_us: int) -> Present | None:  # type: ignore[override]
        if self.playing:
            action = super()._present(now_us)
            self.frame, self._shown = action.frame, (action.pose, self.live.wishes)
            return action
        assert self.info is not None
        assert self.pipeline is not None
        self._due_us = now_us + round(1e6 / self.info.fps)
        self._interpolation.cancel()
        pose, wishes = self._viewpoint.pose_at(now_us), self.live.wishes
        if (pose, wishes) == self._shown and self._decode_queue.quiet:
            return None
        self._shown, half = (pose, wishes), self._begin(now_us)
        traffic = self._decode_queue.traffic()
        return Present(self.frame, now_us, pose, self.pipeline, traffic, half=half, still=True)
