"""From messages to pictures: the client without sockets, threads or clocks.

Shared by real time (``app.py`` calls it from executors) and virtual time (the simulator calls it inline). ``on_*``
decode and store; :meth:`ClientPipeline.present` draws one frame. One thread may decode while another presents.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from cags_client import align, restore
from cags_client.adapt import AdapterStep, SirtAdapter
from cags_client.align import Aligned, AlignSettings, ReferencePicture
from cags_client.carry import OnDisplay, ReferenceViews
from cags_client.expected import Veils
from cags_client.presented import PresentedFrame
from cags_client.references import References
from cags_client.resolution import Resolutions
from cags_client.restore import RestoreInput, Restorer, auto
from cags_client.restore.networks.weights import Weights
from cags_client.settings import AUTO, HALF, ClientSettings, LiveSettings
from cags_client.standin import Drawn, StandIn
from cags_client.stopwatch import Stopwatch
from cags_common import raster
from cags_common.bundle.manifest import Manifest
from cags_common.codecs import tile_codec
from cags_common.effects import Effect, EffectPlan, Situation, held_sh_degree, plan_frame
from cags_common.errors import ConfigError, DecodeError
from cags_common.geometry import F32, Camera, Pose
from cags_common.held_tile import HeldTile
from cags_common.packing import decode_ids
from cags_common.raster.base import DepthKind, Exactness, Footprint, RasterScene, RenderedView, RenderOptions
from cags_common.raster.halving import enlarged, halved
from cags_common.store.gof_store import Committed, GofStore
from cags_common.store.tile_decode import Arrival
from cags_common.store.tile_store import TileStore
from cags_protocol.messages import FrameEnd, ReferenceFrame, TileLayers


class ClientPipeline:
    """Decodes, stores and draws. ``info`` is the manifest's public part. Raises :class:`DecodeError` for codebooks."""

    def __init__(
        self,
        info: Manifest,
        codebooks: bytes,
        settings: ClientSettings,
        *,
        live: LiveSettings | None = None,
        clock: Callable[[], float] = lambda: 0.0,
        background: Executor | None = None,
    ) -> None:
        """``background`` takes the colour adapter off the display path; without it steps run where they are planned."""
        self.info = info
        self.settings = settings
        self.live = live or LiveSettings(settings)
        self._clock = clock
        self._store = TileStore(info, tile_codec(info, codebooks), settings.threads)
        self._references = References(info.near)
        self._rasteriser = raster.create(settings.raster)
        self._scene: RasterScene | None = None
        self._shares: F32 | None = None  # each splat's contribution to the view of the newest reference
        self._sh_degree = 0  # highest band with anything in it since the group's first frame
        self._scene_store: GofStore | None = None
        self._adapter: SirtAdapter | None = None
        self._background = background
        self._adapting: Future[AdapterStep] | None = None  # of the scene as it is; seen from the next frame on
        self._views = ReferenceViews()
        self._veils = Veils(self._rasteriser, info.lod_gains_db)
        self._changes = 0  # of the scene
        prpa = AlignSettings() if settings.erosion else AlignSettings(erosion_iterations=0)
        self._aligner = align.create(settings.align, prpa)
        self._stand_in = StandIn(self._aligner, settings.threads)
        self._resolutions = Resolutions(1e3 / info.fps)
        self._weights: dict[str, Weights] = {}
        self._restorer_wanted = self.live.restore
        self._restorer = self._made_restorer()

    # -------------------------------------------------------------------------------------------------------- decoding

    def on_tiles(self, tiles: Sequence[tuple[TileLayers, memoryview]]) -> list[DecodeError]:
        """Decode layers of tiles; what is wrong with those that are left out. What was held stays."""
        return self._store.add_all([Arrival(m.frame, m.tile, m.from_lod, m.split(payload)) for m, payload in tiles])

    def flush(self) -> list[DecodeError]:
        """After :meth:`on_tiles`: dequantise what they touched, each tile once, off the display path.

        What is wrong with tiles that are left out.
        """
        return self._store.flush()

    def take_dropped(self) -> list[HeldTile]:
        """Tiles of which layers had come and were given up since the last call, for want of memory."""
        return self._store.take_dropped()

    def on_reference(self, message: ReferenceFrame, payload: memoryview) -> bool:
        """Decode a reference; False asks for an IDR picture. Raises :class:`DecodeError`."""
        return self._references.add(message, payload)

    def on_frame_end(self, message: FrameEnd, payload: memoryview) -> None:
        """The frame is whole. Raises :class:`DecodeError`."""
        capacity = self._store.capacity(message.frame)
        what = f"removed ids of frame {message.frame}"
        removed = decode_ids(payload, what=what, limit=max(capacity, 1)) if len(payload) else np.zeros(0, np.int32)
        self._store.end(message.frame, removed)

    def on_weights(self, data: bytes) -> None:
        """Weights trained for this content, in place of those of the program. Raises :class:`DecodeError`."""
        try:
            weights = Weights.from_bytes(data, "weights of the content")
            restore.create(weights.network, weights={weights.network: weights})
        except ConfigError as error:
            raise DecodeError(str(error)) from error
        self._weights[weights.network] = weights
        self._restorer_wanted = ""  # made anew before the next frame

    @property
    def last_reference_seq(self) -> int:
        """The last reference picture that was decoded; 0 before any."""
        return self._references.last_decoded

    @property
    def on_display(self) -> GofStore | None:
        """What is held of the group of frames on display; None before any."""
        return self._store.on_display

    def keeps(self, frame: int) -> bool:
        """Whether a jump to ``frame`` can go on from what is held, of whatever quality."""
        return self._store.keeps and self._store.in_group(frame)

    def holds(self, frame: int) -> bool:
        """Whether ``frame`` can be drawn whole without anything from the network."""
        return self._store.holds(frame)

    def restart_references(self) -> None:
        """The reference video goes on over another connection. The pictures that are there stay in use."""
        self._references.restart()

    def held(self) -> list[HeldTile]:
        """The tiles that are decoded, for a server that takes the session over."""
        return self._store.held()

    def reset(self, frame: int) -> None:
        """The viewer jumped to ``frame``: forget tiles and references."""
        self._store.reset(frame)
        self._references.reset()
        self._scene = None

    def visible_lods(self, camera: Camera) -> dict[tuple[int, int], int]:
        """LoDs shown of each tile (source frame, tile) that has a splat in the picture from ``camera``; draws it."""
        if self._scene is None or self._scene_store is None:
            return {}
        options = RenderOptions(contribution=True, depth=DepthKind.NONE, max_sh_degree=0, threads=self.settings.threads)
        view = self._scene.render(camera, options)
        assert view.contribution is not None
        return self._scene_store.shown.visible_lods(view.contribution)

    # ------------------------------------------------------------------------------------------------------ presenting

    def camera(self, pose: Pose) -> Camera:
        """The display's camera at ``pose``, with the scene's near plane."""
        return Camera(self.settings.intrinsics, pose, self.info.near)

    def present(self, frame: int, camera: Camera, share: float = 0.0) -> PresentedFrame:
        """Draw media frame ``frame`` from ``camera``; with ``share``, after that, what moves so many frames later."""
        started_s = self._clock()
        watch = Stopwatch(self._clock)
        if self._restorer_wanted != self.live.restore:
            self._restorer_wanted = self.live.restore
            self._restorer = self._made_restorer()
        with watch("update"):
            store, committed = self._committed(frame, share)
            scene = self._updated(store, committed)
        reference = self._reference(frame)
        situation = self._situation(store, committed, (frame + share, camera), reference)
        plan = plan_frame(situation, self.settings.effects)
        half = self._resolutions.chosen(self.live.resolution) == HALF
        seen_by = halved(camera) if half else camera
        with watch("raster"):
            view = scene.render(seen_by, self._drawing(plan, half=half))
        drawn = _Drawn(scene, store, seen_by, view.rgb, view)
        aligned, own, shown = None, None, view.rgb
        if reference is not None:
            aligned, own, shown = self._with_reference(plan, drawn, reference, frame, watch)
            if own is not None and own.contribution is not None:
                self._shares = own.contribution
        if half:
            with watch("enlarge"):
                shown = enlarged(shown, camera, self.settings.threads)
        tier = self._tier
        self._observe(started_s, watch.stages_ms)
        return PresentedFrame(
            frame=frame,
            camera=camera,
            rgb=shown,
            drawn=view.rgb,
            aligned=aligned,
            depth=view.depth,
            alpha=view.alpha,
            reference=reference,
            lod_mean=store.shown.lod_mean(camera, self._shares if own is not None else None),
            missed=committed.missed,
            buffer_ms=self._store.ahead(frame) * 1e3 / self.info.fps,
            stages_ms=watch.stages_ms,
            effects=plan,
            share=share,
            tier=tier,
        )

    def _committed(self, frame: int, share: float) -> tuple[GofStore, Committed]:
        moved = self._store.move(frame, share) if share else None
        return moved or self._store.commit(frame)

    def _situation(
        self, store: GofStore, committed: Committed, view: tuple[float, Camera], reference: ReferencePicture | None
    ) -> Situation:
        frame, camera = view
        there = reference.camera.pose.position if reference is not None else None
        return Situation(
            sh_degree=self._sh_degree,
            scene_sh_degree=self.info.sh_degree,
            changed=committed.changed,
            whole=store.full and not committed.missed,
            reference=reference is not None,
            same_place=there == camera.pose.position,
            same_frame=reference is not None and reference.frame == frame,
            restorer=self._restorer.needs,
            replaces=self._replaces,
            adapts=self._adapter is not None,
            depth_shown=self.live.depth_shown,
        )

    def _reference(self, frame: int) -> ReferencePicture | None:
        """The reference to use."""
        return self._references.newest(frame, self.settings.reference_age)

    @property
    def _replaces(self) -> bool:
        return self._tier.partition("@")[0] in restore.REPLACING

    def _made_restorer(self) -> Restorer:
        """The restorer that the viewer wants; with ``auto`` the machine is measured first, which takes a second."""
        s = self.settings
        make = partial(restore.create, threads=s.threads, weights=self._weights)
        if self._restorer_wanted == auto.NAME:
            return auto.measured(make, s.intrinsics, 1e3 / self.info.fps, self._clock)
        return make(self._restorer_wanted)

    @property
    def _tier(self) -> str:
        return self._restorer.tier if isinstance(self._restorer, auto.AutoRestorer) else self._restorer.name

    def _observe(self, started_s: float, stages_ms: dict[str, float]) -> None:
        """Tell ``auto``, of the restorer and of the resolution, what the frame took."""
        now_s = self._clock()
        frame_ms = (now_s - started_s) * 1e3
        if isinstance(self._restorer, auto.AutoRestorer):
            self._restorer.controller.observe(now_s, stages_ms.get("restore"), frame_ms)
        if self.live.resolution == AUTO:
            self._resolutions.observe(now_s, stages_ms, frame_ms)

    def _with_reference(
        self, plan: EffectPlan, drawn: _Drawn, reference: ReferencePicture, frame: int, watch: Stopwatch
    ) -> tuple[Aligned | None, RenderedView | None, F32]:
        """The aligned reference, the client's own view of it, and the restored picture, each where planned."""
        aligned, own, shown = None, None, drawn.distorted
        depth, options = drawn.view.depth, self._reference_options(plan, reference)
        if Effect.OWN_VIEW in plan:
            with watch("own"):
                own = self._views.now(reference, self._held(drawn), options)
        if Effect.ALIGNMENT in plan and depth is not None:
            with watch("align"):
                occlusion, colours = Effect.OCCLUSION in plan, Effect.EROSION in self._restorer.needs
                aligned = self._aligner.align(reference, depth, drawn.camera, occlusion=occlusion, colours=colours)
                if Effect.FADE in plan:
                    aligned = _faded(aligned, self._freshness(reference, frame))
        if Effect.ADAPTATION in plan and own is not None and self._adapter is not None and self._adapting is None:
            with watch("adapt"):
                self._adapting = self._begun(self._adapter, (drawn.scene, reference, own, options))
        if Effect.RESTORATION in plan and aligned is not None:
            inputs = RestoreInput(drawn.distorted, drawn.view.alpha, aligned, reference, own, self._shares)
            with watch("restore"):
                shown = self._restorer.restore(self._veils.watched(inputs, self._held(drawn), options))
        if Effect.STAND_IN in plan and own is not None and depth is not None:
            with watch("stand-in"):
                mine = Drawn(drawn.distorted, drawn.view.alpha, depth, drawn.camera)
                shown = self._stand_in.paint(shown, mine, reference, own, self._freshness(reference, frame))
        return aligned, own, shown

    def _held(self, drawn: _Drawn) -> OnDisplay:
        return OnDisplay(drawn.scene, drawn.store, self._changes)

    def _begun(
        self, adapter: SirtAdapter, work: tuple[RasterScene, ReferencePicture, RenderedView, RenderOptions]
    ) -> Future[AdapterStep]:
        if self._background is not None:
            return self._background.submit(adapter.step, *work)
        done: Future[AdapterStep] = Future()
        done.set_result(adapter.step(*work))
        return done

    def _adapted(self, store: GofStore, *, must_end: bool) -> None:
        """Take over the step under way. It reads the scene, so one that ``must_end`` before an update is waited for."""
        step = self._adapting
        if step is None or self._adapter is None or self._scene is None or not (must_end or step.done()):
            return
        if self._adapter.apply(self._scene, store.splats, step.result()):
            self._changes += 1
        self._adapting = None

    def _updated(self, store: GofStore, committed: Committed) -> RasterScene:
        if self._scene is None or committed.fresh:
            self._adapting = self._shares = None  # of a scene that is gone
            self._scene, self._scene_store = self._rasteriser.load(store.splats), store
            self._adapter = SirtAdapter(store.capacity) if self.settings.adapt == "sirt" else None
            self._sh_degree = held_sh_degree(store.splats.sh_rest)
            self._changes += 1
            return self._scene
        self._adapted(store, must_end=committed.changed)
        if len(committed.moved):
            self._scene.move(committed.moved, store.splats, self.settings.threads)
            self._changes += 1
        if len(committed.rows):
            if self._adapter is not None:
                self._adapter.forget(committed.rows)
            changed = store.splats.take(committed.rows)
            self._scene.update(committed.rows, changed)
            self._changes += 1
            self._sh_degree = max(self._sh_degree, held_sh_degree(changed.sh_rest))
        return self._scene

    def _options(self, plan: EffectPlan) -> RenderOptions:
        return RenderOptions(
            exactness=Exactness(self.live.exactness),
            threads=self.settings.threads,
            max_sh_degree=plan.sh_degree,
            depth=DepthKind.EXPECTED if Effect.DEPTH in plan else DepthKind.NONE,
        )

    def _drawing(self, plan: EffectPlan, *, half: bool) -> RenderOptions:
        options = replace(self._options(plan), displayed=True)
        return replace(options, footprint=options.footprint.at_half_resolution()) if half else options

    def _reference_options(self, plan: EffectPlan, reference: ReferencePicture) -> RenderOptions:
        """How the server draws references, so that the client's splats can be compared with them."""
        footprint = Footprint.of(self.settings.intrinsics, reference.camera.intrinsics)
        return replace(self._options(plan), depth=DepthKind.NONE, footprint=footprint)

    def _freshness(self, reference: ReferencePicture, frame: int) -> float:
        """1 for references up to half as old as is allowed, falling to 0 past the oldest: none goes at a stroke."""
        allowed = self.settings.reference_age + 1
        return min(1.0, 2.0 * (1.0 - (frame - reference.frame) / allowed))


@dataclass(frozen=True, eq=False)
class _Drawn:
    """The client's own picture of a frame, and what it was drawn from."""

    scene: RasterScene
    store: GofStore
    camera: Camera
    distorted: F32
    view: RenderedView


def _faded(aligned: Aligned, freshness: float) -> Aligned:
    if freshness >= 1.0:
        return aligned
    return replace(aligned, paint=lambda: aligned.rgb, confidence=aligned.confidence * np.float32(freshness))
