"""What is known of one viewer: its clock, where its head was, and where it will be."""

from __future__ import annotations

from cags_common.geometry import Camera, Intrinsics, Pose
from cags_protocol.wire.messages import Hello, PoseSample
from cags_server.fov import FovObservation, FovOptions, create_fov_policy
from cags_server.predict import PoseDistribution, PoseHistory, create_predictor
from cags_server.records import FrameRecord
from cags_server.session.clock import ClientClock
from cags_server.settings import ServerSettings

MAX_UNSETTLED = 512
"""Predictions whose outcome is waited for; of a clock that was set back, it never comes."""


def fov_options(settings: ServerSettings) -> FovOptions:
    """The settings that field-of-view policies take."""
    return FovOptions(settings.fov_margin, settings.fov_quantile, settings.fov_gain)


class Viewer:
    """Head poses in, predictions out; what was predicted is compared with what the head did once that is known."""

    def __init__(self, settings: ServerSettings, hello: Hello) -> None:
        self.clock = ClientClock()
        self._first, self._intrinsics, self._near = hello.pose, hello.intrinsics, hello.near
        self._predictor = create_predictor(settings.predictor)
        self._fov = create_fov_policy(settings.fov, fov_options(settings))
        self._history = PoseHistory()
        self._unsettled: list[FrameRecord] = []

    @property
    def intrinsics(self) -> Intrinsics:
        """Intrinsics of the viewer's display."""
        return self._intrinsics

    def camera(self, pose: Pose) -> Camera:
        """The viewer's own camera at ``pose``."""
        return Camera(self._intrinsics, pose, self._near)

    def observe(self, samples: tuple[PoseSample, ...], arrival_us: int) -> None:
        """Poses arrived, oldest first, at ``arrival_us`` of the server's clock."""
        if samples:
            self.clock.observe(samples[-1].t_us, arrival_us)
        for sample in samples:
            self._history.add(sample)
        waiting: list[FrameRecord] = []
        for record in self._unsettled:
            actual = self._history.pose_at(record.display_us)
            if actual is not None:
                record.settle(actual)
                self._fov.truth(record.frame, record.predicted, actual, self._intrinsics)
            elif record.display_us > self._history.newest.t_us:
                waiting.append(record)
        self._unsettled = waiting

    def expect(self, record: FrameRecord) -> None:
        """A frame was planned by a prediction: tell it the truth later."""
        self._unsettled.append(record)
        del self._unsettled[:-MAX_UNSETTLED]

    def ensure_pose(self, now_us: int) -> None:
        """Before the first pose the viewer is where the Hello said."""
        if not len(self._history):
            self._history.add(PoseSample(self.clock.to_client(now_us), self._first))

    def first_view(self) -> PoseDistribution:
        """Where the viewer stands before the client's clock is known: where the Hello said."""
        return PoseDistribution(self._first, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

    def horizon_us(self, display_us: int) -> int:
        """How far ahead of the newest pose ``display_us`` (client clock) is."""
        return max(0, display_us - self._history.newest.t_us)

    def predict(self, display_us: int) -> PoseDistribution:
        """Where the head will be at ``display_us`` (client clock)."""
        return self._predictor.predict(self._history, self.horizon_us(display_us))

    def margins(self, frame: int, predicted: PoseDistribution) -> tuple[float, float]:
        """How much wider than the viewer's own picture the reference of ``frame`` must look."""
        return self._fov.scale(FovObservation(frame, predicted, self._intrinsics))
