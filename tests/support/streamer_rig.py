"""A streamer over a scene in memory, and the link and the clock that a test plays."""

from cags_common.geometry import Pose
from cags_protocol import events as ev
from cags_protocol.messages import Control, PoseSample
from cags_server.bandwidth import MeasuredEstimator
from cags_server.settings import ServerSettings
from cags_server.streamer import Streamer
from support.server_scene import FPS, SETTINGS, hello, library

PERIOD_US = 1e6 / FPS
OFFSET_US = 5_000_000  # the client's clock is this far behind the server's


class Rig:
    """A streamer, its clock, and everything it sent."""

    def __init__(self, settings: ServerSettings = SETTINGS, initial_bps: float = 50e6, **scene: int) -> None:
        self.library = library(**scene)
        estimator = MeasuredEstimator(initial_bps)
        self.streamer = Streamer(self.library, settings, hello(), estimator=estimator)
        self.sent: list[ev.Outgoing] = []
        self.opening = self.streamer.opening(OFFSET_US)
        self.deliver(self.opening)

    def deliver(self, outgoing: list[ev.Outgoing]) -> None:
        for each in outgoing:
            self.streamer.on_event(ev.Delivered(each, 0), 0)

    def control(self, action: str, frame: int = 0, at_us: int = 300_000, **more: object) -> None:
        control = Control(action, frame, at_us, **more)
        self.streamer.on_event(ev.ControlReceived(control, OFFSET_US + 10_000), OFFSET_US + 10_000)

    def poses(self, *times_us: int, pose: Pose | None = None) -> None:
        samples = tuple(PoseSample(t, pose or Pose.identity()) for t in times_us)
        self.streamer.on_event(ev.PosesReceived(samples, OFFSET_US + times_us[-1]), OFFSET_US + times_us[-1])

    def step(self, late_us: int = 0, *, deliver: bool = True) -> list[ev.Outgoing]:
        """Plan and finish the next due frame."""
        due = self.streamer.next_due_us()
        assert due is not None
        job = self.streamer.begin(due + late_us)
        assert job is not None
        out = self.streamer.finish(job.run(), due + late_us)
        if deliver:
            self.deliver(out)
        return out

    def play(self) -> None:
        self.poses(0, 20_000)
        self.control("play")


def of(kind: type, outgoing: list[ev.Outgoing]) -> list:
    return [each.message for each in outgoing if isinstance(each.message, kind)]
