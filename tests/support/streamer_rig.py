"""A streamer over a scene in memory, and the link and the clock that a test plays."""

from typing import Any, TypeVar

from cags_common.geometry import Pose
from cags_common.tiles.inventory import InventoryEntry
from cags_protocol import events as ev
from cags_protocol.wire.messages import Control, Hello, Mark, PoseSample
from cags_server.link import MeasuredLink
from cags_server.scene.library import SceneLibrary
from cags_server.session.streamer import Streamer
from cags_server.settings import ServerSettings
from support.server_scene import FPS, SETTINGS, hello, library

M = TypeVar("M")

PERIOD_US = 1e6 / FPS
OFFSET_US = 5_000_000  # the client's clock is this far behind the server's


class Rig:
    """A streamer, its clock, and everything it sent."""

    def __init__(
        self,
        settings: ServerSettings = SETTINGS,
        initial_bps: float = 50e6,
        *,
        joins: Hello | None = None,
        resumes: tuple[InventoryEntry, ...] | None = None,
        served: SceneLibrary | None = None,
        **scene: Any,
    ) -> None:
        """``joins``: what the client says of itself; ``resumes``: what it holds, where it comes back."""
        self.library = served or library(**scene)
        self.streamer = Streamer(self.library, settings, joins or hello(), link=MeasuredLink(initial_bps))
        if resumes is not None:
            self.streamer.resume(resumes)
        self.now_us = OFFSET_US
        self.marks: list[Mark] = []
        self.opening = self.streamer.startup(OFFSET_US)
        self.greeting = self._greeting()
        self.deliver(self.greeting + self.opening)

    def _greeting(self) -> list[ev.Outgoing]:
        """The first picture, which goes before the first tile."""
        job = self.streamer.begin(self.now_us)
        self.take_marks()
        return [] if job is None else self.streamer.finish(job.run(), self.now_us)

    def take_marks(self) -> list[Mark]:
        """Marks that are to be sent now."""
        marks = of(Mark, self.streamer.take_marks())
        self.marks += marks
        return marks

    def send(self, outgoing: list[ev.Outgoing]) -> None:
        """Write messages to their end."""
        for each in outgoing:
            self.streamer.on_event(ev.Sent(each, self.now_us), self.now_us)
            self.take_marks()

    def deliver(self, outgoing: list[ev.Outgoing]) -> None:
        """Write messages, which arrive."""
        self.send(outgoing)
        for each in outgoing:
            self.streamer.on_event(ev.Delivered(each, self.now_us), self.now_us)

    def drop(self, outgoing: list[ev.Outgoing], reason: str = "stale") -> None:
        """Messages that never arrive."""
        for each in outgoing:
            self.streamer.on_event(ev.Dropped(each, reason, 0, self.now_us), self.now_us)

    def control(self, action: str, frame: int = 0, at_us: int = 300_000, **more: object) -> None:
        self.now_us = max(self.now_us, OFFSET_US + 10_000)
        control = Control(action, frame, at_us, **more)
        self.streamer.on_event(ev.ControlReceived(control, self.now_us), self.now_us)
        self.take_marks()

    def poses(self, *times_us: int, pose: Pose | None = None) -> None:
        samples = tuple(PoseSample(t, pose or Pose.identity()) for t in times_us)
        self.streamer.on_event(ev.PosesReceived(samples, OFFSET_US + times_us[-1]), OFFSET_US + times_us[-1])

    def step(self, late_us: int = 0, *, deliver: bool = True) -> list[ev.Outgoing]:
        """Plan and finish the next due frame, which has a render or not."""
        due = self.frame_due_us()
        assert due is not None
        self.now_us = due + late_us
        job = self.streamer.begin(self.now_us)
        self.take_marks()
        out = self.catch_up(self.now_us) if job is None else self.streamer.finish(job.run(), self.now_us)
        self.take_marks()
        if deliver:
            self.deliver(out)
        return out

    def frame_due_us(self) -> int | None:
        """When the next frame is to be planned; detail may be before it."""
        return self.streamer.frame_due_us()

    def catch_up(self, now_us: int) -> list[ev.Outgoing]:
        """What is due without a render."""
        self.now_us = now_us
        out = self.streamer.catch_up(now_us)
        self.take_marks()
        return out

    def play(self) -> None:
        self.poses(0, 20_000)
        self.control("play")


def of(kind: type[M], outgoing: list[ev.Outgoing]) -> list[M]:
    return [each.message for each in outgoing if isinstance(each.message, kind)]
