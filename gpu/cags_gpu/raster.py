"""The ``gpu`` backend: the WGSL shaders behind the rasteriser seam."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Collection
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

import cags_kernels
from cags_common import raster
from cags_common.correction import Correction, Look
from cags_common.geometry import F32, Camera
from cags_common.raster.base import DepthKind, RasterScene, RenderedView, RenderOptions
from cags_common.raster.checks import (
    MIN_QUATERNION_NORM,
    change,
    check_camera,
    drawable,
)
from cags_common.splats import Splats
from cags_gpu.device import DeviceLostError
from cags_gpu.difference import Comparison, DeviceViews
from cags_gpu.keeper import Keeper, shared_keeper
from cags_gpu.pictures import DevicePictures, frame_pictures
from cags_gpu.scene import Columns, ResidentScene, Target
from cags_gpu.submission import Output, Outputs, Recording, submitted
from cags_gpu.workspace import TooLargeError, Workspace

Result = TypeVar("Result")

_log = logging.getLogger(__name__)


class GpuRasteriser:
    """The backend called ``gpu``. Raises :class:`ConfigError` with the reason where there is no adapter for it."""

    name = "gpu"

    def __init__(self, keeper: Keeper | None = None) -> None:
        self._keeper = keeper or shared_keeper()

    def load(self, splats: Splats) -> GpuScene:
        """Take a copy of ``splats``. Raises :class:`cags_common.errors.SceneError` for values that cannot be drawn."""
        return GpuScene(Splats(*(array.copy() for _, array in drawable(splats).arrays())), self._keeper)


class GpuScene:
    """Splats held by a device, with a copy in memory: after a lost device they are uploaded to the next one.

    While there is none, and for what the adapter's buffers cannot hold, the CPU draws.
    """

    def __init__(self, splats: Splats, keeper: Keeper) -> None:
        self._splats, self._keeper = splats, keeper
        self._resident: ResidentScene | None = None
        self._stand_in: RasterScene | None = None
        self._refused = ""
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._splats)

    @property
    def _held(self) -> tuple[int, int]:
        return len(self._splats), self._splats.sh_rest.shape[1]

    def update(self, rows: NDArray[np.integer], splats: Splats, threads: int = 1) -> None:
        """Take the splats at ``rows`` [M] from ``splats``, those of the whole scene."""
        indices, _ = change(rows, splats, self._held)
        new = drawable(splats.take(indices))
        for (_, held), (_, given) in zip(self._splats.arrays(), new.arrays(), strict=True):
            held[indices] = given
        if self._stand_in is not None:
            self._stand_in.update(indices, self._splats, threads)
        self._change(Columns.of(indices, new))

    def move(self, rows: NDArray[np.integer], splats: Splats, threads: int = 1) -> None:
        """Take position, rotation and opacity at ``rows`` [M] from ``splats``, those of the whole scene.

        36 bytes a row go to the device.
        """
        indices, logits = change(rows, splats, self._held)
        moved = np.take(splats.means, indices, axis=0), logits[indices], np.take(splats.quats, indices, axis=0)
        if not _can_be_drawn(*moved):
            drawable(splats.take(indices))  # says what is wrong with them
        held = self._splats
        held.means[indices], held.logit_opacities[indices], held.quats[indices] = moved
        if self._stand_in is not None:
            self._stand_in.move(indices, held, threads)
        self._change(Columns(indices, motion=moved))

    def render(self, camera: Camera, options: RenderOptions) -> RenderedView:
        """Render one view over black."""
        check_camera(camera)
        if not len(self):
            return _empty_view(camera, options)
        return self.on_device(
            lambda scene: _rendered(scene, camera, options), lambda scene: scene.render(camera, options)
        )

    def frame(
        self, camera: Camera, options: RenderOptions, correction: Correction | None, display: Camera | None = None
    ) -> DevicePictures | None:
        """See :class:`cags_common.correction.FrameScene`."""
        return frame_pictures(self, camera, options, correction, display)

    def compared(
        self, held: RasterScene, camera: Camera, options: RenderOptions, *, knee: float, looks: Collection[Look]
    ) -> DeviceViews | None:
        """See :class:`cags_common.correction.ComparingScene`."""
        if not (isinstance(held, GpuScene) and self.shares_device(held)):
            return None
        check_camera(camera)
        if not (len(self) and len(held)):
            return None
        options = replace(options, depth=DepthKind.NONE, contribution=True)
        return self._keeper.comparisons.views(Comparison(self, held, camera, options, knee, tuple(sorted(looks))))

    def shares_device(self, other: GpuScene) -> bool:
        """Whether both are drawn by the same device, when it is there."""
        return self._keeper is other._keeper and not (self._refused or other._refused)

    def on_device(self, draw: Callable[[ResidentScene], Result], instead: Callable[[RasterScene], Result]) -> Result:
        """What ``draw`` makes of the scene on the device, or ``instead`` on the CPU where that cannot be."""
        workspace = None if self._refused else self._keeper.current()
        if workspace is not None:
            try:
                with workspace.gpu.used():
                    return draw(self.on(workspace))
            except DeviceLostError as error:
                self._keeper.lost(workspace, str(error))
            except TooLargeError as error:
                self._refused = str(error)
                _log.warning("%s; the CPU draws this scene", error)
            self._resident = None
        return instead(self._on_cpu())

    def on(self, workspace: Workspace) -> ResidentScene:
        """The scene in that device's memory; called with the device's lock held."""
        if self._resident is None or self._resident.workspace is not workspace:
            self._resident = ResidentScene(workspace, self._splats)
            self._stand_in = None
        return self._resident

    def _on_cpu(self) -> RasterScene:
        with self._lock:
            if self._stand_in is None:
                name = "cpu" if cags_kernels.native_available() else "oracle"
                self._stand_in = raster.create(name).load(self._splats)
            return self._stand_in

    def _change(self, columns: Columns) -> None:
        resident = self._resident
        if resident is None:
            return
        staged = resident.staged(columns)
        try:
            with resident.gpu.used():
                resident.change(columns.flags, staged)
        except DeviceLostError as error:
            self._resident = None
            self._keeper.lost(resident.workspace, str(error))


def _rendered(scene: ResidentScene, camera: Camera, options: RenderOptions) -> RenderedView:
    pixels = camera.width_px * camera.height_px
    wanted = options.depth is not DepthKind.NONE

    def record(recording: Recording) -> Outputs:
        target = scene.record(recording, camera, options)
        return _outputs(scene, target, options, pixels)

    picture, *rest = submitted(scene.workspace, record)
    shape = (camera.height_px, camera.width_px)
    rgba = picture.view(np.float32).reshape(*shape, 4)
    depth = rest[0].view(np.float32).reshape(shape) if wanted else None
    contribution = rest[-1].view(np.float32) if options.contribution else None
    return RenderedView(np.ascontiguousarray(rgba[..., :3]), np.ascontiguousarray(rgba[..., 3]), depth, contribution)


def _outputs(scene: ResidentScene, target: Target, options: RenderOptions, pixels: int) -> Outputs:
    out = [Output(target["picture"], 16 * pixels)]
    if options.depth is not DepthKind.NONE:
        out.append(Output(target["depth"], 4 * pixels))
    if options.contribution:
        out.append(Output(scene.workspace["contribution"], 4 * scene.count))
    return out


def _empty_view(camera: Camera, options: RenderOptions) -> RenderedView:
    shape = (camera.height_px, camera.width_px)
    depth = None if options.depth is DepthKind.NONE else np.full(shape, np.inf, np.float32)
    contribution = np.zeros(0, np.float32) if options.contribution else None
    return RenderedView(np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32), depth, contribution)


def _can_be_drawn(means: F32, logits: F32, quats: F32) -> bool:
    finite = all(bool(np.isfinite(array).all()) for array in (means, logits, quats))
    squares = np.einsum("ij,ij->i", quats, quats, dtype=np.float64)
    return finite and float(squares.min(initial=np.inf)) >= MIN_QUATERNION_NORM**2
