"""From the client's display path to the page: a :class:`~cags_client.output.FrameSink` around a :class:`LiveView`."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping

from cags_client.frame.presented import PresentedFrame
from cags_client.output.page.controls import SceneInfo, ShownFrame
from cags_client.output.page.server import LiveView
from cags_client.output.sinks import FrameStats
from cags_client.settings import FULL, HALF
from cags_common.bundle.manifest import Manifest
from cags_common.geometry import F32

GOODPUT_WINDOW_US = 1_000_000
PLOTTED = ("lod_mean", "latency_ms", "buffer_ms", "prediction_error_deg", "prediction_error_m", "aligned_share")


class ViewSink:
    """Hands every presented frame to a live view; what it shows for goodput is a sliding second of payload bytes."""

    def __init__(self, view: LiveView) -> None:
        self._view = view
        self._arrived: deque[tuple[int, int]] = deque()
        self._figures: dict[str, float | None] = {}

    def show(self, presented: PresentedFrame, stats: FrameStats) -> None:
        """Leave the frame for the page; never waits."""
        figures = {name: _number(stats.get(name)) for name in PLOTTED if name in stats}
        figures["goodput_mbps"] = self._goodput_mbps(stats)
        self._figures = figures
        self._view.show(shown_frame(presented, figures))

    def show_between(self, presented: PresentedFrame) -> None:
        """Leave a picture between two frames for the page, with the figures of the frame before."""
        self._view.show(shown_frame(presented, self._figures))

    def close(self, *, completed: bool) -> None:
        """The view is stopped by whoever started it."""

    def _goodput_mbps(self, stats: FrameStats) -> float | None:
        time_us = int(stats.get("time_us") or 0)
        received = int(stats.get("bytes_tiles") or 0) + int(stats.get("bytes_reference") or 0)
        if self._arrived and time_us < self._arrived[-1][0]:
            self._arrived.clear()
        self._arrived.append((time_us, received))
        while self._arrived[0][0] <= time_us - GOODPUT_WINDOW_US:
            self._arrived.popleft()
        span_us = time_us - self._arrived[0][0]
        if span_us < GOODPUT_WINDOW_US // 4:
            return None
        return sum(size for _, size in list(self._arrived)[1:]) * 8 / span_us


def shown_frame(presented: PresentedFrame, figures: dict[str, float | None]) -> ShownFrame:
    """The page's view of a presented frame."""
    pictures: dict[str, Callable[[], F32]] = {
        "restored": lambda: presented.rgb,
        "distorted": lambda: presented.distorted,
    }
    aligned, reference = presented.aligned, presented.reference
    if presented.corrected:
        pictures["correction"] = lambda: _made(presented.correction)  # made when it is looked at, and not before
    if reference is not None and (coded := reference.coded) is not None:
        pictures["reference"] = lambda: coded
    return ShownFrame(
        frame=presented.frame,
        camera=presented.camera,
        pictures=_Pictures(pictures),
        planes={"depth": lambda: presented.depth, "confidence": lambda: presented.confidence},
        occluded=None if aligned is None else aligned.occluded,
        reference_camera=None if reference is None else reference.camera,
        stages_ms=presented.stages_ms,
        stats=figures,
        missed=presented.missed,
        resolution=HALF if presented.half else FULL,
    )


def _made(picture: F32 | None) -> F32:
    assert picture is not None
    return picture


class _Pictures(Mapping[str, F32]):
    """Pictures that are made when they are asked for."""

    def __init__(self, makers: Mapping[str, Callable[[], F32]]) -> None:
        self._makers = makers

    def __getitem__(self, name: str) -> F32:
        return self._makers[name]()

    def __iter__(self) -> Iterator[str]:
        return iter(self._makers)

    def __len__(self) -> int:
        return len(self._makers)


def scene_info(manifest: Manifest) -> SceneInfo:
    """What the page must know of a clip."""
    return SceneInfo(
        name=manifest.name,
        frames=manifest.frames,
        fps=manifest.fps,
        up=manifest.up,
        focus_centre=manifest.focus_centre,
        focus_radius=manifest.focus_radius,
        lods=manifest.lods,
        near=manifest.near,
        bounds=manifest.bounds,
        view={} if manifest.view is None else manifest.view.table(),
    )


def _number(value: float | int | bool | None) -> float | None:
    return None if value is None else float(value)
