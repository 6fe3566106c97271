"""The pictures of a frame that a device made: what is shown has come, the rest comes when somebody looks at it."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cags_common.correction import Correction
from cags_common.geometry import F32, Camera
from cags_common.raster.base import DepthKind, RenderedView, RenderOptions
from cags_gpu.correct import Frame, Pixels
from cags_gpu.device import DeviceLostError
from cags_gpu.scene import ResidentScene, SceneOnDevice, Target
from cags_gpu.submission import read_back


def frame_pictures(
    scene: SceneOnDevice, camera: Camera, options: RenderOptions, correction: Correction | None, display: Camera | None
) -> DevicePictures | None:
    """See :meth:`cags_common.correction.FrameScene.frame`."""
    frame = Frame(camera, options, correction, display=display, confidence=True)
    if not len(scene):
        return None

    def draw(resident: ResidentScene) -> DevicePictures:
        target = frame.target_of(resident, resident.spare_role(camera))
        made = DevicePictures(scene, frame, resident, target)
        target.hold_for(made)
        made.take(frame.draw(resident, target))
        return made

    return scene.on_device(draw, lambda _: None)


class DevicePictures:
    """A frame's pictures: what is shown is here, the rest on the device as long as this lives.

    Once the device is lost they are those of the scene as it is then, drawn by the CPU.
    """

    def __init__(self, scene: SceneOnDevice, frame: Frame, resident: ResidentScene, target: Target) -> None:
        self._scene, self._frame, self._target = scene, frame, target
        self._workspace = resident.workspace
        self._shown: Pixels = np.zeros((0, 0, 4), np.uint8)

    def take(self, shown: Pixels) -> None:
        """The picture has come."""
        whole = self._frame.display or self._frame.camera
        self._shown = shown.reshape(whole.height_px, whole.width_px, 4)

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns that the frame was worked out at."""
        return self._frame.camera.height_px, self._frame.camera.width_px

    @cached_property
    def rgb(self) -> F32:
        """[H, W, 3] in [0, 1], whole levels of 255: what is shown."""
        return np.multiply(self._shown[..., :3], np.float32(1 / 255), dtype=np.float32)

    @cached_property
    def confidence(self) -> F32 | None:
        """[h, w] in whole levels of 255; None where nothing was added."""
        if self._frame.correction is None:
            return None
        step = 1 if self._frame.display is None else 2
        return np.multiply(self._shown[::step, ::step, 3], np.float32(1 / 255), dtype=np.float32)

    @property
    def drawn(self) -> F32:
        """[h, w, 3] in [0, 1]: the client's own render."""
        return self._view.rgb

    @property
    def alpha(self) -> F32:
        """[h, w] in [0, 1]."""
        return self._view.alpha

    @cached_property
    def depth(self) -> F32 | None:
        """[h, w]; +inf where void, or thin where something was added. None where nothing needed it."""
        if self._frame.drawing.depth is DepthKind.NONE:
            return None
        read = self._read("depth", np.float32, 1)
        return self._anew.depth if read is None else read.reshape(self.size)

    @cached_property
    def _view(self) -> RenderedView:
        compact = self._frame.compact
        read = self._read("picture", np.uint16 if compact else np.float32, 4)
        if read is None:
            return self._anew
        rgba = np.multiply(read.reshape(*self.size, 4), np.float32(1 / 65535 if compact else 1), dtype=np.float32)
        return RenderedView(np.ascontiguousarray(rgba[..., :3]), np.ascontiguousarray(rgba[..., 3]), None, None)

    @cached_property
    def _anew(self) -> RenderedView:
        return self._scene.render(self._frame.camera, self._frame.drawing)

    def _read(self, name: str, kind: type[np.generic], each: int) -> NDArray[Any] | None:
        """``each`` values of a kind a pixel, of a buffer of the frame; None where the device is gone."""
        height, width = self.size
        size = each * height * width * np.dtype(kind).itemsize
        try:
            with self._workspace.gpu.used():
                return read_back(self._workspace, self._target[name], size).view(kind)
        except DeviceLostError:
            return None
