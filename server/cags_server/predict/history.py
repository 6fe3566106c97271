"""What is known of a viewer's motion: pose samples in the order of their times, whatever order they came in.

Networks delay, repeat and lose samples, clocks jump, viewers teleport. The history keeps what prediction may lean on: a
bounded stretch of samples, and within it the *segment* since the last break in the motion.
"""

from __future__ import annotations

import bisect
from array import array
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from cags_common import so3
from cags_common.geometry import F64, Pose, angle_between
from cags_protocol.wire.messages import PoseSample

HISTORY_US = 4_000_000
"""How far back samples are kept: enough to refit a predictor to the viewer of this minute."""

MAX_SAMPLES = 4096
"""Bound on the samples kept (1 kHz over the whole stretch)."""

GAP_US = 450_000
"""Neighbours further apart in time say nothing of the motion between them (5 Hz input stays connected)."""

MAX_ANGULAR_SPEED_RAD_S = 40.0
"""Heads turn at up to about 20 rad/s; anything faster between two samples is a cut, not a motion."""

MAX_SPEED_M_S = 25.0
"""Faster between two samples is a teleport (world units)."""

CLOCK_RESTART_SAMPLES = 8
"""After so many samples in a row from before the history, the sender's clock has been set back: start anew."""


class PoseHistory:
    """The recent pose samples of one viewer."""

    def __init__(self, samples: Iterable[PoseSample] = ()) -> None:
        self._times = array("q")
        self._poses: list[Pose] = []
        self._values = array("d")  # positions and rotations again, seven a sample: what becomes an array at one stroke
        self._breaks: list[bool] = []  # whether the motion from the sample before to this one is a gap or a cut
        self._from_the_past: list[PoseSample] = []
        for sample in samples:
            self.add(sample)

    def __len__(self) -> int:
        return len(self._times)

    @property
    def newest(self) -> PoseSample:
        """The sample of the latest time. Raises ``ValueError`` where there is none."""
        if not self._times:
            raise ValueError("the pose history is empty; nothing can be predicted before the first pose")
        return PoseSample(self._times[-1], self._poses[-1])

    def add(self, sample: PoseSample) -> None:
        """Take a sample; late ones find their place, one of a known time replaces the earlier one."""
        if self._times and sample.t_us < self._times[-1] - HISTORY_US:
            self._take_old(sample)
            return
        self._from_the_past.clear()
        at = bisect.bisect_left(self._times, sample.t_us)
        if at < len(self._times) and self._times[at] == sample.t_us:
            self._poses[at] = sample.pose
            self._values[at * 7 : at * 7 + 7] = _values(sample.pose)
        else:
            self._times.insert(at, sample.t_us)
            self._poses.insert(at, sample.pose)
            self._values[at * 7 : at * 7] = _values(sample.pose)
            self._breaks.insert(at, False)
        for i in (at, at + 1):
            if i < len(self._times):
                self._breaks[i] = i > 0 and self._is_break(i)
        self._trim()

    def _take_old(self, sample: PoseSample) -> None:
        self._from_the_past.append(sample)
        if len(self._from_the_past) >= CLOCK_RESTART_SAMPLES:
            restart, self._from_the_past = self._from_the_past, []
            del self._times[:], self._poses[:], self._values[:], self._breaks[:]
            for old in restart:
                self.add(old)

    def _trim(self) -> None:
        first = bisect.bisect_left(self._times, self._times[-1] - HISTORY_US)
        first = max(first, len(self._times) - MAX_SAMPLES)
        if first > 0:
            del self._times[:first], self._poses[:first], self._values[: first * 7], self._breaks[:first]

    def pose_at(self, t_us: int) -> Pose | None:
        """The pose at a time that samples lie on both sides of (or at), interpolated; None where none do."""
        at = bisect.bisect_left(self._times, t_us)
        if at < len(self._times) and self._times[at] == t_us:
            return self._poses[at]
        if at == 0 or at == len(self._times) or self._breaks[at]:
            return None
        fraction = (t_us - self._times[at - 1]) / (self._times[at] - self._times[at - 1])
        return self._poses[at - 1].towards(self._poses[at], fraction)

    def segment(self) -> tuple[NDArray[np.int64], F64, F64]:
        """Times [N], positions [N, 3] and unit quaternions [N, 4] since the last gap or cut; N is at least 1."""
        first = self._segment_start()
        values = np.array(self._values[first * 7 :]).reshape(-1, 7)
        return np.array(self._times[first:], dtype=np.int64), values[:, :3], values[:, 3:]

    def _segment_start(self) -> int:
        if not self._times:
            raise ValueError("the pose history is empty; nothing can be predicted before the first pose")
        for i in range(len(self._times) - 1, 0, -1):
            if self._breaks[i]:
                return i
        return 0

    def _is_break(self, i: int) -> bool:
        """Whether the motion from sample ``i - 1`` to ``i`` is a gap or a cut."""
        dt_us = self._times[i] - self._times[i - 1]
        if dt_us > GAP_US:
            return True
        a, b = self._poses[i - 1], self._poses[i]
        seconds = max(dt_us, 5_000) / 1e6  # time stamps closer than 5 ms carry their own jitter
        moved = sum((x - y) ** 2 for x, y in zip(a.position, b.position, strict=True)) ** 0.5
        turned = angle_between(a.rotation, b.rotation)
        return moved > MAX_SPEED_M_S * seconds or turned > MAX_ANGULAR_SPEED_RAD_S * seconds

    def on_grid(self, step_us: int, max_points: int) -> tuple[F64, F64]:
        """Positions [N, 3] and rotations [N, 4] every ``step_us``, ending at the newest sample, oldest first.

        Interpolated within the last segment, never extrapolated: N is 1 to ``max_points``.
        """
        times, positions, rotations = self.segment()
        count = min(max_points, int((times[-1] - times[0]) // step_us) + 1)
        if count < 2:
            return positions[-1:], rotations[-1:]
        grid = times[-1] - step_us * np.arange(count - 1, -1, -1, dtype=np.int64)
        after = np.clip(np.searchsorted(times, grid, side="left"), 1, len(times) - 1)
        before = after - 1
        fraction = (grid - times[before]) / (times[after] - times[before])
        between = positions[before] + fraction[:, None] * (positions[after] - positions[before])
        return between, so3.slerp(rotations[before], rotations[after], fraction)


def _values(pose: Pose) -> array[float]:
    return array("d", (*pose.position, *pose.rotation))
