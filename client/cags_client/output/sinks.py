"""The sink seam."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, TypeAlias, runtime_checkable

from cags_client.frame.presented import PresentedFrame

FrameStats: TypeAlias = Mapping[str, float | int | bool | None]
"""The frame's line of the report: ``frame``, ``time_us``, ``latency_ms``, ``lod_mean``, bytes, stage times, ..."""


@runtime_checkable
class LiveSink(Protocol):
    """A sink that somebody looks at while it plays: it takes the pictures between media frames, too."""

    def show_between(self, presented: PresentedFrame) -> None:
        """Take one picture, as :meth:`FrameSink.show` does."""
        ...


class FrameSink(Protocol):
    """Takes every frame that was presented. Called in one thread beside the display path, in order."""

    def show(self, presented: PresentedFrame, stats: FrameStats) -> None:
        """Take one frame. Arrays of ``presented`` must not be changed. Raises :class:`CagsError`."""
        ...

    def close(self, *, completed: bool) -> None:
        """Nothing more follows. Unless ``completed``, what was begun is removed."""
        ...
