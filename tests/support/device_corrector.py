"""The shaders' correction of views that no rasteriser drew: they are written where a drawing would lie."""

from __future__ import annotations

from typing import Any

import numpy as np

from cags_common.correction import Corrected, Correction, CorrectSettings, Reference
from cags_common.geometry import F32, Camera
from cags_common.raster import Exactness, RenderedView, RenderOptions
from cags_gpu.correct import Frame
from cags_gpu.device import Handle
from cags_gpu.scene import ResidentScene, Target
from cags_gpu.submission import Output, Outputs, Recording, submitted
from support.gpu import rasteriser
from support.raster_scenes import splat


class DeviceCorrector:
    """Behind the seam of correctors."""

    name = "gpu"

    def __init__(self, exactness: Exactness = Exactness.EXACT) -> None:
        """Views are kept as a client's own are that is drawn for a display: in floats, or in 16 bits a channel."""
        self._options = RenderOptions(exactness=exactness, displayed=True)
        self._scene = rasteriser().load(splat((0.0, 0.0, -40.0)))

    def needs_own(self, reference: Reference) -> bool:
        """Always of a picture: nothing is kept."""
        return reference.picture

    def correct(
        self,
        view: RenderedView,
        camera: Camera,
        reference: Reference,
        own: F32 | None = None,
        settings: CorrectSettings | None = None,
        *,
        veto: F32 | None = None,
    ) -> Corrected:
        """See :class:`cags_common.correction.Corrector`."""
        given = Correction(reference, camera.intrinsics, settings or CorrectSettings())
        frame = Frame(camera, self._options, given, veto, floats=True)

        def draw(resident: ResidentScene) -> F32:
            target = resident.target(camera)
            thin = view.alpha < given.settings.hole_alpha  # a drawing leaves those without depth
            _write(resident, target["depth"], np.where(thin, np.float32(np.inf), view.depth))
            picture = np.dstack([view.rgb, view.alpha])
            if frame.compact:
                sixteen = np.round(np.clip(picture, 0, 1) * 65535).astype(np.uint16)
                resident.gpu.device.queue.write_buffer(target["picture"], 0, sixteen)
            else:
                _write(resident, target["picture"], picture)
            resident.held = None
            resident.record = lambda *_, **__: _own(resident, reference, own)  # type: ignore[method-assign]

            def record(recording: Recording) -> Outputs:
                frame._finish(recording, resident, target)
                return [Output(target["shown_floats"], 16 * view.alpha.size)]

            return submitted(resident.workspace, record)[0].view(np.float32).reshape(*view.alpha.shape, 4)

        rgba = self._scene.on_device(draw, lambda _: None)
        assert rgba is not None, "the device is there"
        return Corrected(rgba[..., :3].copy(), rgba[..., 3].copy())


def _own(resident: ResidentScene, reference: Reference, own: F32 | None) -> Target:
    assert own is not None
    target = resident.target(reference.camera, "own")
    _write(resident, target["picture"], np.dstack([own, np.ones(own.shape[:2], np.float32)]))
    return target


def _write(resident: ResidentScene, buffer: Handle, array: Any) -> None:
    resident.gpu.device.queue.write_buffer(buffer, 0, np.ascontiguousarray(array, np.float32))
