"""The sink seam."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, TypeAlias

from cags_client.presented import PresentedFrame

FrameStats: TypeAlias = Mapping[str, float | int | bool | None]
"""The frame's line of the report: ``frame``, ``time_us``, ``latency_ms``, ``lod_mean``, bytes, stage times, ..."""


class FrameSink(Protocol):
    """Takes every frame that was presented. Called in one thread beside the display path, in order."""

    def show(self, presented: PresentedFrame, stats: FrameStats) -> None:
        """Take one frame. Arrays of ``presented`` must not be changed. Raises :class:`CagsError`."""
        ...

    def close(self, *, completed: bool) -> None:
        """Nothing more follows. Unless ``completed``, what was begun is removed."""
        ...
