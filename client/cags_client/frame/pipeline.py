"""The client's pipeline from messages to pictures, without sockets, threads or clocks.

Real time (``app.py``, from executors) and virtual time (the simulator, inline) share it. Methods ``on_*`` decode and
store. :meth:`ClientPipeline.present` draws one frame: it commits what the reference assumes, rasterises, and adds what
the client lacks. One thread may decode while another presents.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from cags_client.frame import align, restore
from cags_client.frame.align import Aligned, AlignSettings
from cags_client.frame.changes import Changes
from cags_client.frame.painting import Canvas, Painter, StagedPictures
from cags_client.frame.presented import PresentedFrame
from cags_client.frame.restore import CORRECT, NONE, RestoreInput, Restorer, expected_errors, expected_psnr_db
from cags_client.settings import ClientSettings, LiveSettings
from cags_client.stats import Stopwatch
from cags_client.store.references import Received, References
from cags_common import raster
from cags_common.bundle.codecs import SvqTileCodec, tile_codec
from cags_common.bundle.manifest import Manifest
from cags_common.coding.packing import decode_ids
from cags_common.correction import Correction, FramePictures
from cags_common.correction.reach import apart, valid_share
from cags_common.errors import ConfigError, DecodeError
from cags_common.geometry import Camera, Pose
from cags_common.passes import Pass, PassPlan, Situation, held_sh_degree, plan_frame
from cags_common.raster.base import DepthKind, Exactness, RasterScene, RenderOptions
from cags_common.store.gof_buffer import Committed, GofBuffer
from cags_common.store.tile_decode import Arrival, TileOpener
from cags_common.store.tile_store import TileStore
from cags_common.tiles.inventory import InventoryEntry
from cags_protocol.wire.messages import FrameEnd, Mark, ReferenceFrame, ReferenceKind, TileLayers

PATIENCE_FRAMES = 3
"""Frames to wait for a late reference before showing more than the previous one assumes, if that one says anything."""


class ClientPipeline:
    """Decodes, stores and draws; ``info`` is the public part of the manifest."""

    def __init__(
        self,
        info: Manifest,
        settings: ClientSettings,
        *,
        live: LiveSettings | None = None,
        clock: Callable[[], float] = lambda: 0.0,
    ) -> None:
        """References can be decoded at once, tiles after :meth:`on_codebooks`."""
        self.info = info
        self.settings = settings
        self.live = live or LiveSettings(settings)
        self._clock = clock
        self._opener = TileOpener(None, settings.threads)
        self._store = TileStore(info, None, opener=self._opener)
        self._marked = self._marked_before = 0  # newest mark of the store; newest mark of earlier connections
        self._references = References(info.near)
        self._rasteriser = raster.create(settings.raster)
        self._scene: RasterScene | None = None
        self._scene_store: GofBuffer | None = None
        self._sh_degree = 0  # highest nonzero band since the group's first frame
        self._shown_frame = 0
        self._committed_mark = 0
        self._used = 0  # order of the newest displayed reference
        self._changes = Changes()
        self._scene_changes = 0
        self._painter = Painter(settings.threads)
        prpa = AlignSettings() if settings.erosion else AlignSettings(erosion_iterations=0)
        self._aligner = align.create(settings.align, prpa)
        self._weights: bytes | None = None
        self._errors = expected_errors(info)
        self._restorer_wanted = self.live.restore
        self._restorer = self._made_restorer()

    # -------------------------------------------------------------------------------------------------------- decoding

    def on_base_codebooks(self, data: bytes) -> None:
        """Receive the part of the codebooks that tiles need at LoD 0. Raises :class:`DecodeError`."""
        if self._opener.codec is None:
            self._opener.codec = tile_codec(self.info, data)

    def on_codebooks(self, data: bytes) -> None:
        """Receive the codebooks that tiles need for decoding. Raises :class:`DecodeError`."""
        if isinstance(self._opener.codec, SvqTileCodec):
            self._opener.codec.extend(data)
        else:
            self._opener.codec = tile_codec(self.info, data)

    @property
    def opens_tiles(self) -> bool:
        """Whether enough of the codebooks has come."""
        return self._opener.codec is not None

    def on_tiles(self, tiles: Sequence[tuple[TileLayers, memoryview]]) -> list[DecodeError]:
        """Decode layers of tiles and return the errors of skipped ones. Held levels stay."""
        return self._store.add_all([Arrival(m.frame, m.tile, m.from_lod, m.split(payload)) for m, payload in tiles])

    def flush(self) -> list[DecodeError]:
        """After :meth:`on_tiles`: dequantise the touched tiles, each once, off the display path.

        Returns the errors of skipped tiles.
        """
        return self._store.flush()

    def take_dropped(self) -> list[InventoryEntry]:
        """Tiles with layers that were discarded for lack of memory since the last call."""
        return self._store.take_dropped()

    def on_mark(self, mark: Mark) -> list[DecodeError]:
        """Everything received before the mark is the basis of references that name it. Returns errors of skipped tiles.

        Raises :class:`DecodeError` unless marks rise.
        """
        number = self._marked_before + mark.number
        if number <= self._marked:
            raise DecodeError(f"mark {mark.number} came after mark {self._marked - self._marked_before}: marks rise")
        if mark.restart:
            self._store.reset(self._shown_frame)
            self._references.reset()
        self._marked = number
        return self._store.mark(number)

    def on_reference(self, message: ReferenceFrame, payload: memoryview) -> bool:
        """Decode a reference; returns False to request an IDR picture. Raises :class:`DecodeError`."""
        return self._references.add(message, payload, self._marked_before + message.basis)

    def on_frame_end(self, message: FrameEnd, payload: memoryview) -> None:
        """The frame is complete. Raises :class:`DecodeError`."""
        capacity = self._store.capacity(message.frame)
        what = f"removed ids of frame {message.frame}"
        removed = decode_ids(payload, what=what, limit=capacity)
        self._store.end(message.frame, removed)

    def on_weights(self, data: bytes) -> None:
        """Receive weights of a restorer trained for this content; ignored without one. Raises :class:`DecodeError`."""
        wanted = self.settings.restore
        if wanted in (CORRECT, NONE):
            return
        try:
            restore.create(wanted, threads=self.settings.threads, weights=data)
        except ConfigError as error:
            raise DecodeError(str(error)) from error
        self._weights = data
        self._restorer_wanted = ""  # recreated before the next frame

    @property
    def last_reference_seq(self) -> int:
        """Number of the last decoded reference picture; 0 before any."""
        return self._references.last_decoded

    @property
    def on_display(self) -> GofBuffer | None:
        """The buffer of the displayed group of frames; None before any."""
        return self._store.on_display

    @property
    def kept(self) -> range:
        """Frames among which playback can jump and go on with held tiles, at any quality."""
        return self._store.kept

    def holds(self, frame: int) -> bool:
        """Whether ``frame`` can be drawn completely without further data."""
        return self._store.holds(frame)

    def restarted(self, inventory: Sequence[InventoryEntry]) -> None:
        """Continue with another connection, whose server knows that ``inventory`` is held.

        Received references stay in use.
        """
        self._references.restart()
        self._marked_before = self._marked
        self._store.restarted(inventory)

    def held(self) -> list[InventoryEntry]:
        """The decoded tiles, for a server that takes the session over."""
        return self._store.held()

    def reset(self, frame: int) -> None:
        """The viewer jumped to ``frame``: forget tiles and references."""
        self._shown_frame = frame
        self._store.reset(frame)
        self._references.reset()
        self._scene = None

    @property
    def references_received(self) -> int:
        """Number of references received so far."""
        return self._references.count

    def jump(self, frame: int) -> None:
        """The viewer jumped to ``frame``, where the held tiles do: forget references."""
        self._shown_frame = frame
        self._references.reset()

    def forget_references(self, until: int) -> None:
        """Discard the first ``until`` received references."""
        self._references.reset(until)

    def visible_lods(self, camera: Camera) -> dict[tuple[int, int], int]:
        """Displayed LoDs of the tiles (source frame, tile) that the picture from ``camera`` depends on: looks, motion,
        updates. Renders that picture.
        """
        if self._scene is None or self._scene_store is None:
            return {}
        options = RenderOptions(contribution=True, depth=DepthKind.NONE, max_sh_degree=0, threads=self.settings.threads)
        view = self._scene.render(camera, options)
        assert view.contribution is not None
        return self._scene_store.visible_lods(view.contribution)

    # ------------------------------------------------------------------------------------------------------ presenting

    def camera(self, pose: Pose) -> Camera:
        """The display's camera at ``pose``, with the scene's near plane."""
        return Camera(self.settings.intrinsics, pose, self.info.near)

    def present(
        self, frame: int, camera: Camera, share: float = 0.0, *, half: bool = False, still: bool = False
    ) -> PresentedFrame:
        """Draw media frame ``frame`` from ``camera``, with splats moved to ``share`` frames after it. ``still``: the
        clip stands still there, so that no reference of a later frame is waited for.

        At ``half`` everything up to the shown picture is computed on a quarter of the pixels, through a footprint of
        its own; only that picture is enlarged.
        """
        watch = Stopwatch(self._clock)
        self._shown_frame = frame
        if self._restorer_wanted != self.live.restore:
            self._restorer_wanted = self.live.restore
            self._restorer = self._made_restorer()
        self._references.show(frame, self.info.frames)
        reference = self._references.newest(self.settings.reference_age)
        with watch("update"):
            store, committed = self._committed(frame, share, reference, still=still)
            scene = self._updated(store, committed)
            if reference is not None and reference.frame == frame and reference.order > self._used:
                self._used = reference.order
                self._changes.used(reference.basis)
            if self._restorer_wanted == CORRECT and self.info.motion is not None and not share:
                self._changes.shown(frame, store.splats.means)
        weight = 0.0 if reference is None else self._weight(reference, frame, camera)
        situation = self._situation(store, committed, (frame + share, camera), reference, weight)
        plan = plan_frame(situation, self.settings.effects)
        canvas = Canvas(scene, self._scene_changes, camera, half, self._options(plan))
        pictures: FramePictures
        aligned, used = None, reference if reference is not None and reference.coded is not None else None
        lod_mean = store.shown.lod_mean(camera)
        if used is not None and Pass.RESTORATION in plan:
            expected_db = expected_psnr_db(lod_mean, self.info)
            aligned, pictures = self._restored(plan, canvas, used, watch, weight=weight, expected_db=expected_db)
        else:
            given = self._correction(plan, canvas, store, used, weight) if used and Pass.CORRECTION in plan else None
            pictures = self._painter.paint(canvas, given, watch)
        return PresentedFrame(
            frame=frame,
            camera=camera,
            pictures=pictures,
            aligned=aligned,
            reference=reference,
            lod_mean=lod_mean,
            missed=committed.missed,
            buffer_ms=self._store.ahead(frame) * 1e3 / self.info.fps,
            stages_ms=watch.stages_ms,
            effects=plan,
            share=share,
            tier=self._restorer_wanted,
        )

    def _committed(
        self, frame: int, share: float, reference: Received | None, *, still: bool
    ) -> tuple[GofBuffer, Committed]:
        """Commit the frame up to the right mark."""
        moved = self._store.move(frame, share) if share else None
        if moved is not None:
            return moved
        basis = self._basis_at(frame, reference, still=still)
        newest = self._marked
        store, committed = self._store.commit(frame, basis)
        if committed.fresh:
            self._changes.clear()
        mark = newest + 1 if basis is None else basis
        self._changes.committed(frame, mark, committed.rows, committed.began)
        return store, committed

    def _basis_at(self, frame: int, reference: Received | None, *, still: bool) -> int | None:
        """The mark up to which ``frame`` is shown; None for everything received.

        With a difference this is the mark that it assumes. A picture assumes none, because it is compared with the
        displayed splats; the frame is then shown up to the mark of the next received reference, or to the newest mark
        (always, while the clip stands ``still``).
        While the frame's reference is late, the frame is shown up to the mark of the newest received one, which may
        have come after its own frame, but to no mark before the displayed one. If that one says nothing, there is
        nothing to keep in force, and nothing is waited for. Without references there are no marks.
        """
        if reference is not None and reference.assumes:
            own, empty = reference.frame == frame, reference.kind is ReferenceKind.NOTHING
            if own or (not empty and frame - reference.frame <= PATIENCE_FRAMES):
                self._committed_mark = max(reference.basis, 0 if own else self._committed_mark)
                return self._committed_mark
        coming = None if still else self._references.next_basis()
        self._committed_mark = self._marked if coming is None else min(coming, self._marked)
        return self._committed_mark or None

    def _situation(
        self,
        store: GofBuffer,
        committed: Committed,
        view: tuple[float, Camera],
        reference: Received | None,
        weight: float,
    ) -> Situation:
        time, camera = view
        speaks = reference is not None and reference.kind is not ReferenceKind.NOTHING and weight > 0
        name = self._restorer_wanted.partition("@")[0]
        there = reference.camera.pose.position if reference is not None else None
        return Situation(
            sh_degree=self._sh_degree,
            scene_sh_degree=self.info.sh_degree,
            whole=store.full and not committed.missed,
            reference=speaks and name != NONE,
            picture=reference is not None and reference.kind is ReferenceKind.PICTURE,
            same_place=there == camera.pose.position,
            certain=reference is not None and reference.frame == int(time) and weight == 1,
            corrects=name == CORRECT,
            stale=reference is not None and self._outdated(reference, time),
            restorer=self._restorer.needs if self._restorer is not None else frozenset(),
            replaces=self._restorer is not None and self._restorer.replaces,
            depth_shown=self.live.depth_shown,
        )

    def _outdated(self, reference: Received, time: float) -> bool:
        """Whether splats have changed until ``time`` in a way that ``reference`` does not assume."""
        return self._changes.since(reference.frame, reference.basis) if reference.assumes else reference.frame < time

    def _made_restorer(self) -> Restorer | None:
        """The restorer of aligned pictures that the viewer chose; None for another choice."""
        if self._restorer_wanted in (CORRECT, NONE):
            return None
        return restore.create(self._restorer_wanted, threads=self.settings.threads, weights=self._weights)

    def _correction(
        self, plan: PassPlan, canvas: Canvas, store: GofBuffer, reference: Received, weight: float
    ) -> Correction:
        """What the client lacks in the frame according to ``reference``, and where the reference is not valid."""
        changed = None
        if Pass.VETO in plan:
            since = reference.frame, reference.basis if reference.assumes else None
            changed = self._changes.spheres(since, store.splats, canvas.camera, reference.camera.intrinsics.fx_px)
        stale = 1.0 - weight if Pass.FADE in plan else 0.0
        # with a reference's own frame, the comparison itself tells how good the splats are
        known = self._references.beginning and reference.frame != self._shown_frame
        own_error = store.shown.error_mean(canvas.camera, self._errors) if known else math.nan
        return Correction(reference.reference(own_error), canvas.display.intrinsics, changed=changed, stale=stale)

    def _restored(
        self,
        plan: PassPlan,
        canvas: Canvas,
        reference: Received,
        watch: Stopwatch,
        *,
        weight: float,
        expected_db: float,
    ) -> tuple[Aligned | None, StagedPictures]:
        """The aligned picture and the restorer's result."""
        view, picture = self._painter.view(canvas, watch), reference.picture
        made = StagedPictures.of(view)
        if picture is None or view.depth is None or self._restorer is None:
            return None, self._painter.finished(canvas, made, watch)
        with watch("align"):
            occlusion, colours = Pass.OCCLUSION in plan, Pass.EROSION in self._restorer.needs
            aligned = self._aligner.align(picture, view.depth, canvas.camera, occlusion=occlusion, colours=colours)
            if Pass.FADE in plan:
                aligned = _faded(aligned, weight)
        with watch("restore"):
            rgb = self._restorer.restore(RestoreInput(view.rgb, aligned, expected_db))
        return aligned, self._painter.finished(canvas, StagedPictures.of(view, rgb, aligned.confidence), watch)

    def _updated(self, store: GofBuffer, committed: Committed) -> RasterScene:
        self._scene_changes += committed.fresh or len(committed.rows) > 0
        if self._scene is None or committed.fresh:
            self._scene, self._scene_store = self._rasteriser.load(store.splats), store
            self._sh_degree = held_sh_degree(store.splats.sh_rest)
            return self._scene
        if len(committed.moved):
            self._scene.move(committed.moved, store.splats, self.settings.threads)
        if len(committed.rows):
            self._scene.update(committed.rows, store.splats, self.settings.threads)
            if self._sh_degree < self.info.sh_degree:
                changed = store.splats.sh_rest.take(committed.rows, axis=0)
                self._sh_degree = max(self._sh_degree, held_sh_degree(changed))
        return self._scene

    def _options(self, plan: PassPlan) -> RenderOptions:
        return RenderOptions(
            exactness=Exactness(self.live.exactness),
            threads=self.settings.threads,
            max_sh_degree=plan.sh_degree,
            depth=DepthKind.EXPECTED if Pass.DEPTH in plan else DepthKind.NONE,
        )

    def _weight(self, reference: Received, frame: int, camera: Camera) -> float:
        """Of a reference: 1 up to half of the allowed age, then falling to 0, so that none vanishes at once. A
        difference has less beyond its reach; a picture is compared with what the client shows, or stands for it.
        """
        allowed = self.settings.reference_age + 1
        fresh = min(1.0, 2.0 * (1.0 - (frame - reference.frame) / allowed))
        if reference.kind is not ReferenceKind.DIFFERENCE:
            return fresh
        away = apart(camera.pose, reference.camera.pose, self.info.focus_centre, self.info.focus_radius)
        return fresh * valid_share(away, reference.reach)


def _faded(aligned: Aligned, weight: float) -> Aligned:
    if weight >= 1.0:
        return aligned
    return replace(aligned, paint=lambda: aligned.rgb, confidence=aligned.confidence * np.float32(weight))
