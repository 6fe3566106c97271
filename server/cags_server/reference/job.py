"""The reference of one planned frame: the only heavy work a client causes, made to run in an executor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cags_common.correction import ComparingScene, DrawnViews, StagedViews
from cags_common.geometry import F32, Camera, Intrinsics
from cags_common.motion.apply import ABSENT_LOGIT
from cags_common.raster.base import DepthKind, Footprint, RasterScene, RenderedView, RenderOptions
from cags_protocol.wire.messages import ReferenceKind
from cags_server.predict.base import PoseDistribution
from cags_server.records import Ahead
from cags_server.reference.coder import Coded, ReferenceCoder
from cags_server.reference.detail import octaves_finer
from cags_server.reference.lasting import Blocks, blocks_of
from cags_server.reference.mirror import Mirror
from cags_server.scene.library import SceneLibrary
from cags_server.scene.visible_tiles import VisibleTile
from cags_server.visibility.ghosts import StaleSplats

NOTHING = Coded(ReferenceKind.NOTHING)

MANY_NEW = 0.02
"""Share of a frame's splats with other looks than now from which on it is drawn to see which of them are visible."""

SHOWS = 1e-4
"""Share of a reference's pixels from which on splats that the client lacks are seen."""


@dataclass(frozen=True, slots=True)
class FramePlan:
    """What was decided when a frame was begun: ``planned_us`` by the server's clock, ``display_us`` by the client's."""

    generation: int  # counts seeks and the like: what was planned before one is void after it
    tick: int
    frame: int
    ahead: Ahead
    before: tuple[Ahead, ...]
    """Frames before ``ahead`` that no earlier plan served, as at the beginning of playback."""
    ticks_covered: int  # since the plan before it, its own included: each earns the bytes of its time
    skipped: int  # those of them that the client displays, and that were passed over because the server was late
    planned_us: int
    display_us: int
    horizon_us: int
    predicted: PoseDistribution
    margins: tuple[float, float]
    light: bool = False
    """Whether its reference is coded lightly."""
    speaks: bool = True
    """Whether a reference is made of it; else it is drawn, if at all, to see which splats are visible."""
    idr: bool = False
    basis: int = 0
    """Number of the mark that the reference assumes."""
    greets: bool = False
    """Whether it is the first picture of a client that has just joined, and no frame in its turn."""


@dataclass(frozen=True, eq=False)
class FrameRender:
    """The outcome of a job: the reference on the wire, and what is seen."""

    plan: FramePlan
    intrinsics: Intrinsics
    coded: Coded
    visible: tuple[VisibleTile, ...]
    contribution: F32  # [capacity] by splat id, to the frame whose tiles are planned
    render_ns: int
    mirror_ns: int
    encode_ns: int

    @property
    def took_us(self) -> float:
        """Time that the job took, without what it waited for."""
        return (self.render_ns + self.mirror_ns + self.encode_ns) / 1e3


@dataclass(frozen=True, eq=False)
class FrameJob:
    """Renders the unquantised frame as the client would see it, shrunk, and the client's own splats; codes what the
    client lacks. A client's jobs run in turn.
    """

    plan: FramePlan
    library: SceneLibrary
    mirror: Mirror | None
    """None if no reference ever says what the client lacks."""
    compares: bool
    """Whether this one may say it; if not, the mirror only takes note of what was sent."""
    camera: Camera
    client: Intrinsics
    coder: ReferenceCoder
    visible_px: float
    threads: int
    stale: StaleSplats
    plain_footprint: bool = False
    """Whether references are drawn as any picture of their size, as in the paper."""

    def run(self, clock_ns: Callable[[], int] | None = None) -> FrameRender:
        """Do the work; ``clock_ns``, if given, times its parts."""
        if not self.plan.speaks:
            return self._run(None, clock_ns or _no_clock)
        # Held to the end: otherwise the look at the frame ahead would move this scene on.
        with self.library.scenes.at(self.plan.frame) as scene:
            return self._run(scene, clock_ns or _no_clock)

    def _run(self, truth: RasterScene | None, clock: Callable[[], int]) -> FrameRender:
        """``truth`` is None where no reference is made."""
        started = clock()
        if self.mirror is not None and not self.compares:
            self.mirror.follow(self.plan.frame, self.plan.basis)
        footprint = Footprint.classic() if self.plain_footprint else self._footprint(self.camera)
        options = RenderOptions(footprint=footprint, depth=DepthKind.NONE, contribution=True, threads=self.threads)
        drawn, contribution = (None, self._seen_ahead(options)) if truth is None else self._drawn(truth, options)
        worth = self.stale.added_to(contribution, self.plan.ahead.frame)
        visible = self.library.visible_tiles(self.plan.ahead.frame, worth, self.visible_px)
        rendered = clock()
        views = self._staged(drawn, options) if isinstance(drawn, RenderedView) else drawn
        mirrored = clock()
        octaves = octaves_finer(self.client, self.camera.intrinsics)
        plan = self.plan
        coded = NOTHING
        if views is not None:
            coded = self.coder.code_views(
                views,
                idr=plan.idr,
                octaves=octaves,
                light=plan.light,
                camera=self.camera,
                appeared=None if drawn is None else self._appeared(drawn),
            )
        return FrameRender(
            plan=plan,
            intrinsics=self.camera.intrinsics,
            coded=coded,
            visible=visible,
            contribution=contribution,
            render_ns=rendered - started,
            mirror_ns=mirrored - rendered,
            encode_ns=clock() - mirrored,
        )

    def _drawn(self, truth: RasterScene, options: RenderOptions) -> tuple[RenderedView | DrawnViews, F32]:
        """The true view, compared with the client's where that is done in one go; and what splats contribute to the
        frame whose tiles are planned.
        """
        drawn = self._together(truth, options) or truth.render(self.camera, options)
        assert drawn.contribution is not None
        return drawn, self._contribution_ahead(drawn.contribution, options)

    def _footprint(self, camera: Camera) -> Footprint:
        return Footprint.of(self.client, camera.intrinsics)

    def _together(self, scene: RasterScene, options: RenderOptions) -> DrawnViews | None:
        """Truth and mirror, drawn and compared in one go by scenes that can; None: one after the other."""
        if not isinstance(scene, ComparingScene):
            return None
        held = self._held()
        if held is None:
            return None
        return scene.compared(held, self.camera, options, knee=self.coder.knee, looks=self.coder.looks)

    def _staged(self, drawn: RenderedView, options: RenderOptions) -> StagedViews:
        """The true view, and the view of the mirror from the same camera if there is one that holds splats."""
        scene = self._held()
        if scene is None:
            return StagedViews(drawn.rgb, None)
        held = scene.render(self.camera, replace(options, contribution=False, depth=DepthKind.EXPECTED))
        return StagedViews(drawn.rgb, held.rgb, held.depth)

    def _held(self) -> RasterScene | None:
        """What the client draws; None where it holds nothing, or is not compared with."""
        if self.mirror is None or not self.compares:
            return None
        return self.mirror.scene_at(self.plan.frame, self.plan.basis)

    def _appeared(self, drawn: RenderedView | DrawnViews) -> Blocks | None:
        """Where splats are seen that have just appeared, and that the client's basis does not have yet."""
        held = self.mirror.splats if self.mirror is not None and self.compares else None
        contribution = drawn.contribution
        if held is None or contribution is None or len(held) != len(contribution):
            return None
        lacking = (held.logit_opacities <= ABSENT_LOGIT) & (contribution > 0)
        if contribution[lacking].sum() <= SHOWS * self.camera.width_px * self.camera.height_px:
            return None
        return blocks_of(self.library.scenes.changed(self.plan.frame, lacking), self.camera)

    def _contribution_ahead(self, contribution: F32, options: RenderOptions) -> F32:
        """[capacity] what splats contribute to the frame whose tiles are planned: as to this one, unless splats appear
        until then, or many get other looks. For these it is drawn: were they found only when their own frame is drawn,
        they would come after the mark that its reference assumes, and a difference would have to replace them.
        """
        ahead, frame = self.plan.ahead.frame, self.plan.frame
        if ahead == frame:
            return contribution
        if self.library.gof_start(ahead) == self.library.gof_start(frame):
            now, then = self.library.owners(frame), self.library.owners(ahead)
            there = then >= 0
            appear = bool((there & (now < 0)).any())
            if not appear and (there & (then != now)).sum() <= MANY_NEW * there.sum():
                return contribution
        return self._seen_ahead(options)

    def _seen_ahead(self, options: RenderOptions) -> F32:
        """[capacity] what splats contribute to the frame whose tiles are planned, seen by half the pixels a side."""
        camera = replace(self.camera, intrinsics=_halved(self.camera.intrinsics))
        options = replace(options, footprint=self._footprint(camera))
        with self.library.scenes.at(self.plan.ahead.frame) as scene:
            view = scene.render(camera, options)
        assert view.contribution is not None
        return np.asarray(4 * view.contribution, np.float32)


def _halved(intrinsics: Intrinsics) -> Intrinsics:
    width, height = max(intrinsics.width_px // 2, 1), max(intrinsics.height_px // 2, 1)
    x, y = width / intrinsics.width_px, height / intrinsics.height_px
    i = intrinsics
    return Intrinsics(width, height, i.fx_px * x, i.fy_px * y, i.cx_px * x, i.cy_px * y)


def _no_clock() -> int:
    return 0
