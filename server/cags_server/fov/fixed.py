"""The same margin for every frame (the paper's ablation renders 10 % wider than the client's view)."""

from __future__ import annotations

from cags_common.geometry import Intrinsics, Pose
from cags_server.fov.base import FovObservation


class FixedFov:
    """``margin`` on both axes."""

    def __init__(self, margin: float) -> None:
        self._margin = margin

    def scale(self, observation: FovObservation) -> tuple[float, float]:
        """See :class:`~cags_server.fov.base.FovPolicy`."""
        return self._margin, self._margin

    def truth(self, frame: int, predicted: Pose, actual: Pose, client: Intrinsics) -> None:
        """Nothing is learnt."""
