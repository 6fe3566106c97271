"""Where the viewer is, and which poses the server has yet to be told."""

from __future__ import annotations

from typing import Protocol

from cags_common.geometry import Pose
from cags_protocol.wire.limits import MAX_POSE_SAMPLES
from cags_protocol.wire.messages import PoseSample


class PoseSource(Protocol):
    """Where the viewer's head is. A :class:`~cags_common.poses.PoseTrace` is one; a mouse may be another."""

    def pose_at(self, t_us: int) -> Pose:
        """T_world_camera at a time of the walk: 0 when play is asked for, ``start_delay_ms`` at the first frame."""
        ...


class Viewpoint:
    """The walk, laid over the client's clock. It begins when play is asked for; until then the viewer waits there."""

    def __init__(self, poses: PoseSource, rate_hz: float, lead_us: int, now_us: int) -> None:
        """``lead_us``: time from the beginning of the walk to the first frame."""
        self._poses, self._lead_us = poses, lead_us
        self._period_us = round(1e6 / rate_hz)
        self._first_frame_us: int | None = None
        self.next_us = now_us
        """When the next pose is to be sampled."""

    def begin(self, first_frame_us: int) -> None:
        """Play has been asked for; its first frame is displayed at ``first_frame_us``."""
        self._first_frame_us = first_frame_us

    def pose_at(self, t_us: int) -> Pose:
        """T_world_camera at a time of the client's clock."""
        if self._first_frame_us is None:
            return self._poses.pose_at(0)
        return self._poses.pose_at(max(t_us - self._first_frame_us + self._lead_us, 0))

    def due(self, now_us: int) -> list[PoseSample]:
        """The samples up to ``now_us``, oldest first: one batch's worth at most, the newest, after a long sleep."""
        missed = (now_us - self.next_us) // self._period_us - MAX_POSE_SAMPLES + 1
        self.next_us += max(missed, 0) * self._period_us
        samples = []
        while self.next_us <= now_us:
            samples.append(PoseSample(self.next_us, self.pose_at(self.next_us)))
            self.next_us += self._period_us
        return samples
