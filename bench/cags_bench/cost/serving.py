"""References of a moment from the product's own parts: drawn and coded by the server, applied by the client."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cags_bench.cost.moments import Moment
from cags_client.store.references import Received
from cags_common import correction
from cags_common.geometry import F32, Camera
from cags_common.raster.base import DepthKind, Footprint, RasterScene, RenderedView, RenderOptions
from cags_common.video.h264 import H264Decoder
from cags_protocol.wire.limits import PROTOCOL_VERSION
from cags_protocol.wire.messages import Hello, ReferenceKind
from cags_server.reference.coder import Coded, ReferenceCoder
from cags_server.settings import ServerSettings

DIFFERENCES = ServerSettings(references=ReferenceKind.DIFFERENCE.value)
"""Defaults, except for the kind of references, which ``auto`` chooses in the course of a session."""

FPS = 30.0


@dataclass(eq=False)
class Referring:
    """References of one moment under ``settings``, drawn with ``footprint`` (None: the client's own)."""

    moment: Moment
    settings: ServerSettings = DIFFERENCES
    footprint: Footprint | None = None

    def __post_init__(self) -> None:
        hello = Hello(PROTOCOL_VERSION, self.moment.camera.intrinsics, self.moment.camera.pose)
        self._coder = ReferenceCoder(self.settings, hello, FPS)

    @property
    def camera(self) -> Camera:
        """Camera of references."""
        camera = self.moment.reference_camera
        return replace(camera, intrinsics=camera.intrinsics.resized(self._coder.width_px, self._coder.height_px))

    def drawn(self) -> tuple[F32, F32 | None]:
        """The true view [h, w, 3], and the client's view from the reference camera if the server needs it."""
        truth = self._seen(self.moment.true)
        return truth, self._seen(self.moment.held) if self._coder.compares else None

    def coded(self, truth: F32, held: F32 | None) -> Coded:
        """Code the views as an IDR picture."""
        return self._coder.code(truth, held, idr=True)

    def made(self) -> Coded:
        """All work of a server for a reference."""
        return self.coded(*self.drawn())

    def received(self, coded: Coded) -> Received | None:
        """The reference after decoding; None if it says nothing."""
        if coded.kind is ReferenceKind.NOTHING:
            return None
        picture = H264Decoder().decode(coded.access_unit)
        assert picture is not None, "an IDR picture decodes by itself"
        frame = self.moment.frame
        return Received(frame, 1, 1, self.camera, coded.kind, picture, coded.knee, error=coded.after or 0.0)

    def corrected(self, reference: Received | None, view: RenderedView | None = None) -> F32:
        """The client's corrected picture [H, W, 3]; ``view`` is the uncorrected one (None: drawn now)."""
        moment = self.moment
        seen = view or moment.view()
        if reference is None:
            return seen.rgb
        given = reference.reference()
        own = self._seen(moment.held) if given.picture else None
        return correction.create().correct(seen, moment.camera, given, own).rgb

    def _seen(self, scene: RasterScene) -> F32:
        camera = self.camera
        footprint = self.footprint or Footprint.of(self.moment.camera.intrinsics, camera.intrinsics)
        rgb = scene.render(camera, RenderOptions(footprint=footprint, depth=DepthKind.NONE)).rgb
        return np.ascontiguousarray(rgb.clip(0, 1))
