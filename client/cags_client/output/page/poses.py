"""Where the viewer is: poses from the page, or a walk until somebody takes hold of the camera."""

from __future__ import annotations

import threading
from collections import OrderedDict

from cags_client.playback.viewpoint import PoseSource
from cags_common.geometry import Pose

REMEMBERED_POSES = 512
"""Poses whose time can still be told from a picture: at 60 a second more than eight seconds."""


class LivePoses:
    """The newest pose that the page sent; before the first one and after :meth:`release`, the walk's. Thread-safe."""

    def __init__(self, walk: PoseSource) -> None:
        self._walk = walk
        self._held: Pose | None = None
        self._times: OrderedDict[Pose, int] = OrderedDict()
        self._lock = threading.Lock()

    def pose_at(self, t_us: int) -> Pose:
        """Where the camera is now; ``t_us`` matters to the walk alone."""
        with self._lock:
            held = self._held
        return held if held is not None else self._walk.pose_at(t_us)

    def hold(self, pose: Pose, at_us: int) -> None:
        """Put the camera at ``pose``; ``at_us``, of the page's clock, is told back with the picture that shows it."""
        with self._lock:
            self._held = pose
            self._times[pose] = at_us
            self._times.move_to_end(pose)
            if len(self._times) > REMEMBERED_POSES:
                self._times.popitem(last=False)

    def release(self) -> None:
        """Follow the walk again."""
        with self._lock:
            self._held = None

    def forget_times(self) -> None:
        """Another page steers from now on: the times told were of a clock that is not its own."""
        with self._lock:
            self._times.clear()

    def time_of(self, pose: Pose) -> int | None:
        """When, by the page's clock, it was at a pose that was held lately."""
        with self._lock:
            return self._times.get(pose)

    @property
    def held(self) -> bool:
        """Whether somebody has hold of the camera."""
        with self._lock:
            return self._held is not None
