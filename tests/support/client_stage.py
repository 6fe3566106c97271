"""A client's pipeline on a stage: what a server would send it, in the order of its connection."""

from __future__ import annotations

import numpy as np

from cags_client.frame.pipeline import ClientPipeline
from cags_client.frame.presented import PresentedFrame
from cags_client.settings import HALF, ClientSettings
from cags_common import raster
from cags_common.bundle import BundleReader
from cags_common.bundle.codecs import tile_codec
from cags_common.correction import compand
from cags_common.geometry import F32, Camera, Intrinsics, Pose
from cags_common.poses import Focus, synthetic_walk
from cags_common.raster.base import Footprint, RenderOptions
from cags_common.store.tile_decode import Arrival
from cags_common.store.tile_store import TileStore
from cags_common.video.colour import Chroma
from cags_common.video.h264 import H264Decoder, H264Encoder
from cags_protocol.wire.messages import FrameEnd, Mark, ReferenceFrame, ReferenceKind, TileLayers

VIEW = Intrinsics.of_fov(80, 60, 1.3, 1.1)
"""Of references: a little wider than the client's."""

KNEE = 0.12


class Stage:
    """A pipeline, and its server: ``send`` and ``refer`` as a connection would bring them, ``show`` draws."""

    def __init__(self, reader: BundleReader, **settings: object) -> None:
        self.reader = reader
        client = ClientSettings(**{"width": 160, "height": 120, **settings})  # type: ignore[arg-type]
        self.pipe = ClientPipeline(reader.manifest, client)
        self.pipe.on_codebooks(reader.codebooks())
        self._mirror = TileStore(reader.manifest, tile_codec(reader.manifest, reader.codebooks()), 1)
        self._seq = self._mark = 0

    def send(self, frame: int, lods: int = 1, *, every: int = 1, first: int = 0) -> None:
        """Levels ``first`` to ``lods`` - 1 of every ``every``-th tile of a frame, and its end."""
        for entry in self.reader.frame(frame).tiles[::every]:
            levels = range(first, min(lods, len(entry.lod_bytes)))
            if levels:
                parts = [self.reader.payload(frame, entry.tile, lod) for lod in levels]
                message = TileLayers(frame, entry.tile, first, levels.stop, tuple(map(len, parts)))
                payload = memoryview(b"".join(parts))
                assert self.pipe.on_tiles([(message, payload)]) == []
                self._mirror.add_all([Arrival(frame, entry.tile, first, message.split(payload))])
        self.end(frame)

    def end(self, frame: int) -> None:
        """The end of a frame, with the ids that it removes."""
        self.pipe.on_frame_end(FrameEnd(frame), memoryview(self.reader.removed_payload(frame)))
        self._mirror.end(frame, self.reader.removed_ids(frame))

    def mark(self) -> int:
        """A mark, for a reference of what was sent up to here."""
        self._mark += 1
        self.pipe.on_mark(Mark(self._mark))
        self._mirror.mark(self._mark)
        return self._mark

    def refer(self, frame: int, pose: Pose, kind: ReferenceKind = ReferenceKind.DIFFERENCE) -> None:
        """A mark, and the reference of ``frame`` from ``pose`` that assumes it."""
        message, unit = self.reference(frame, pose, kind)
        assert self.pipe.on_reference(message, memoryview(unit))

    def reference(
        self, frame: int, pose: Pose, kind: ReferenceKind = ReferenceKind.DIFFERENCE, *, crf: float | None = None
    ) -> tuple[ReferenceFrame, bytes]:
        """As :meth:`refer`, but the reference does not come by itself. ``crf``: of a picture's video, which then says
        what it has left.
        """
        basis = self.mark()
        if kind is ReferenceKind.NOTHING:
            return ReferenceFrame(frame, self._seq, pose, VIEW, kind=kind.value, basis=basis), b""
        self._seq += 1
        camera = Camera(VIEW, pose, self.reader.manifest.near)
        truth = self._drawn(self.reader.source(frame).splats, camera)
        coded = truth
        if kind is ReferenceKind.DIFFERENCE:
            store, _ = self._mirror.commit(frame, basis)
            coded = compand(truth - self._drawn(store.splats, camera), KNEE).astype(np.float32)
        quality = {} if crf is None else {"crf": crf}
        unit = H264Encoder(VIEW.width_px, VIEW.height_px, 30, chroma=Chroma.FULL, **quality).encode(coded, idr=True)
        decoded = None if crf is None else H264Decoder().decode(unit)
        error = 0.0 if decoded is None else float(np.square(decoded - coded).mean())
        return ReferenceFrame(frame, self._seq, pose, VIEW, True, kind.value, basis, KNEE, error), unit

    def _drawn(self, splats: object, camera: Camera) -> F32:
        footprint = Footprint.of(self.pipe.settings.intrinsics, camera.intrinsics)
        scene = raster.create("auto").load(splats)  # type: ignore[arg-type]
        return scene.render(camera, RenderOptions(footprint=footprint)).rgb.clip(0, 1)

    def show(self, frame: int, pose: Pose, share: float = 0.0) -> PresentedFrame:
        """What the viewer sees."""
        half = self.pipe.settings.resolution == HALF
        return self.pipe.present(frame, self.pipe.camera(pose), share, half=half)

    def truth(self, frame: int, pose: Pose) -> F32:
        """What the viewer should see [H, W, 3]."""
        scene = raster.create("auto").load(self.reader.source(frame).splats)
        return scene.render(self.pipe.camera(pose), RenderOptions()).rgb.clip(0, 1)


def walk(reader: BundleReader, t_us: int = 1_400_000) -> Pose:
    """Where somebody stands who walks about the scene."""
    m = reader.manifest
    return synthetic_walk("walking", Focus(m.focus_centre, m.focus_radius, m.up), duration_s=2).pose_at(t_us)
