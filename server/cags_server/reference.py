"""The reference picture of one planned frame: the only heavy work a client causes, made to run in an executor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from cags_common.geometry import F32, Camera, Intrinsics
from cags_common.raster.base import DepthKind, Footprint, RenderOptions
from cags_common.video.h264 import is_idr
from cags_common.video.noise import CodingNoise
from cags_server.library import SceneLibrary
from cags_server.lingering import Lingering
from cags_server.predict.base import PoseDistribution
from cags_server.reference_encoder import ReferenceEncoder
from cags_server.visible import VisibleTile


@dataclass(frozen=True, slots=True)
class FramePlan:
    """What was decided when a frame was begun: ``planned_us`` by the server's clock, ``display_us`` by the client's."""

    generation: int  # counts seeks and the like: what was planned before one is void after it
    tick: int
    frame: int
    ticks_covered: int  # 1, and one more for every frame that was skipped for lateness
    planned_us: int
    display_us: int
    horizon_us: int
    predicted: PoseDistribution
    margins: tuple[float, float]
    idr: bool


@dataclass(frozen=True, eq=False)
class FrameRender:
    """The outcome of a job: the picture on the wire, and what is seen in it."""

    plan: FramePlan
    intrinsics: Intrinsics
    access_unit: bytes
    idr: bool
    noise: CodingNoise | None
    visible: tuple[VisibleTile, ...]
    contribution: F32  # [capacity] by splat id
    render_ns: int
    encode_ns: int


@dataclass(frozen=True, eq=False)
class FrameJob:
    """Renders the unquantised frame as the client would see it, shrunk, and encodes it. A client's jobs run in turn."""

    plan: FramePlan
    library: SceneLibrary
    camera: Camera
    client: Intrinsics
    encoder: ReferenceEncoder
    visible_px: float
    threads: int
    lingering: Lingering

    def run(self, clock_ns: Callable[[], int] | None = None) -> FrameRender:
        """Do the work; ``clock_ns``, if given, times its parts."""
        clock = clock_ns or _no_clock
        started = clock()
        options = RenderOptions(
            footprint=Footprint.of(self.client, self.camera.intrinsics),
            depth=DepthKind.NONE,
            contribution=True,
            threads=self.threads,
        )
        with self.library.scenes.at(self.plan.frame) as scene:
            view = scene.render(self.camera, options)
        assert view.contribution is not None
        worth = self.lingering.added_to(view.contribution, self.plan.frame)
        visible = self.library.visible_tiles(self.plan.frame, worth, self.visible_px)
        rendered = clock()
        unit, noise = self.encoder.encode(view.rgb, idr=self.plan.idr)
        return FrameRender(
            plan=self.plan,
            intrinsics=self.camera.intrinsics,
            access_unit=unit,
            idr=is_idr(unit),
            noise=noise,
            visible=visible,
            contribution=view.contribution,
            render_ns=rendered - started,
            encode_ns=clock() - rendered,
        )


def _no_clock() -> int:
    return 0
