"""The client's whole frame and the server's reference on the device: what is read back is what is shown or coded."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cags_common.correction import oracle
from cags_common.correction.base import (
    CELL_PX,
    VETO_CELL_PX,
    Corrected,
    CorrectSettings,
    Placement,
    Reference,
    checked_veto,
)
from cags_common.correction.compander import compand
from cags_common.geometry import F32, Camera
from cags_common.raster.base import DepthKind, Footprint, RenderedView, RenderOptions
from cags_common.raster.checks import check_camera
from cags_gpu.device import Handle
from cags_gpu.graph import Counts, Dispatch, buffer_bytes, build, encode
from cags_gpu.layout import COMPAND, CORRECTION
from cags_gpu.raster import GpuScene
from cags_gpu.scene import ResidentScene, Target
from cags_gpu.submission import Outputs, Recording, submitted

Pixels = NDArray[np.uint8]


def shown(
    scene: GpuScene,
    camera: Camera,
    options: RenderOptions,
    reference: Reference | None,
    settings: CorrectSettings | None = None,
    *,
    veto: F32 | None = None,
) -> Pixels:
    """The frame to show [H, W, 4], 8 bits a channel, opaque: drawn, what is lacking sampled by depth, added.

    ``veto``: as :meth:`cags_common.correction.Corrector.correct` takes it. Raises ``ValueError`` where it does not fit.
    """
    frame = _Frame(camera, options, reference, settings or CorrectSettings(), veto, floats=False)
    if not len(scene):
        return _as_bytes(frame.on_cpu(scene).rgb)
    return scene.on_device(frame.on_device, lambda _: _as_bytes(frame.on_cpu(scene).rgb))


def corrected(
    scene: GpuScene,
    camera: Camera,
    options: RenderOptions,
    reference: Reference | None,
    settings: CorrectSettings | None = None,
    *,
    veto: F32 | None = None,
) -> Corrected:
    """As :func:`shown`, as floats, with the confidence."""
    frame = _Frame(camera, options, reference, settings or CorrectSettings(), veto, floats=True)
    if not len(scene):
        return frame.on_cpu(scene)

    def draw(resident: ResidentScene) -> Corrected:
        rgba = frame.on_device(resident).view(np.float32).reshape(camera.height_px, camera.width_px, 4)
        return Corrected(np.ascontiguousarray(rgba[..., :3]), np.ascontiguousarray(rgba[..., 3]))

    return scene.on_device(draw, lambda _: frame.on_cpu(scene))


@dataclass(frozen=True, eq=False)
class CodedReference:
    """What a server makes of a view for a client."""

    coded: F32  # [h, w, 3] in [0, 1]: the companded difference; compander.ZERO where nothing is lacking
    truth: RenderedView  # without depth; with contributions where asked for
    mirror: F32  # [h, w, 3] the client's copy


def coded_reference(
    truth: GpuScene, mirror: GpuScene, camera: Camera, options: RenderOptions, knee: float
) -> CodedReference:
    """Draw ``truth`` and the client's copy from ``camera`` and compand their difference, in one submission."""
    check_camera(camera)
    flat = replace(options, depth=DepthKind.NONE)

    def on_cpu(_: object) -> CodedReference:
        views = [scene.render(camera, flat) for scene in (truth, mirror)]
        lack = np.clip(views[0].rgb, 0, 1) - np.clip(views[1].rgb, 0, 1)
        return CodedReference(compand(lack, knee).astype(np.float32), views[0], views[1].rgb)

    if not (len(truth) and len(mirror)):
        return on_cpu(None)
    return truth.on_device(lambda resident: _coded(resident, mirror.on(resident.workspace), camera, flat, knee), on_cpu)


def _coded(
    truth: ResidentScene, mirror: ResidentScene, camera: Camera, options: RenderOptions, knee: float
) -> CodedReference:
    height, width = camera.height_px, camera.width_px
    pixels = height * width

    def record(recording: Recording) -> Outputs:
        # the mirror last and without contributions: those of the truth stay where they are
        true = truth.record(recording, camera, options, role="truth")
        held = mirror.record(recording, camera, replace(options, contribution=False), role="mirror")
        job = truth.gpu.uniform(COMPAND.pack(size=(width, height), knee=knee))
        named = {"compand_job": job, "truth": true["picture"], "mirror": held["picture"], "coded_out": true["residual"]}
        encode(recording.encoder, build(truth.gpu, "compand", true.counts, {}, named.__getitem__))
        outputs = [(true["residual"], 12 * pixels), (true["picture"], 16 * pixels), (held["picture"], 16 * pixels)]
        if options.contribution:
            outputs.append((truth.workspace["contribution"], 4 * truth.count))
        return outputs

    coded, true, held, *rest = (out.view(np.float32) for out in submitted(truth.workspace, record))
    rgba, mirrored = true.reshape(height, width, 4), held.reshape(height, width, 4)
    colours, alpha = np.ascontiguousarray(rgba[..., :3]), np.ascontiguousarray(rgba[..., 3])
    view = RenderedView(colours, alpha, None, rest[0].copy() if rest else None)
    return CodedReference(coded.reshape(height, width, 3).copy(), view, np.ascontiguousarray(mirrored[..., :3]))


@dataclass(frozen=True, eq=False)
class _Frame:
    """One frame of a client, however it is made."""

    camera: Camera
    options: RenderOptions
    reference: Reference | None
    settings: CorrectSettings
    veto: F32 | None
    floats: bool

    def __post_init__(self) -> None:
        check_camera(self.camera)
        if self.veto is not None:
            checked_veto(self.veto, self.camera)

    @property
    def _drawing(self) -> RenderOptions:
        thin = max(self.options.void_alpha, self.settings.hole_alpha)
        return replace(self.options, depth=DepthKind.EXPECTED, contribution=False, void_alpha=thin)

    @property
    def _own_drawing(self) -> RenderOptions:
        assert self.reference is not None
        footprint = Footprint.of(self.camera.intrinsics, self.reference.camera.intrinsics)
        return replace(self._drawing, footprint=footprint, depth=DepthKind.NONE)

    def on_cpu(self, scene: GpuScene) -> Corrected:
        view = scene.render(self.camera, self._drawing)
        if self.reference is None:
            return Corrected(np.clip(view.rgb, 0, 1), np.zeros(view.alpha.shape, np.float32))
        own = scene.render(self.reference.camera, self._own_drawing).rgb if self.reference.picture else None
        return oracle.correct(view, self.camera, self.reference, own, self.settings, veto=self.veto)

    def on_device(self, scene: ResidentScene) -> Pixels:
        height, width = self.camera.height_px, self.camera.width_px
        each = 16 if self.floats else 4

        def record(recording: Recording) -> Outputs:
            target = scene.record(recording, self.camera, self._drawing)
            self._finish(recording, scene, target)
            return [(target[self._output], each * height * width)]

        (out,) = submitted(scene.workspace, record)
        return out.reshape(height, width, each).copy()

    @property
    def _output(self) -> str:
        return "shown_floats" if self.floats else "shown"

    def _finish(self, recording: Recording, scene: ResidentScene, target: Target) -> None:
        """What follows the drawing: the picture as it is, or with what the reference says is lacking."""
        scene.gpu.device.queue.write_buffer(target.correction, 0, self._job())
        named = {"correction": target.correction, "shown": target[self._output]}
        if self.reference is None:
            encode(recording.encoder, self._steps(scene, target, "plain", target.counts, named))
            return
        counts = target.counts | _reference_counts(self.camera, self.reference.camera)
        named |= {name: scene.kept(name, size) for name, size in buffer_bytes("reference", counts).items()}
        named["veto"] = target["veto_pixels" if self._veto_cell == 1 else "veto_cells"]
        if self.veto is not None:
            scene.gpu.device.queue.write_buffer(named["veto"], 0, np.ascontiguousarray(self.veto, np.float32))
        self._expand(recording, scene, target, counts, named)
        encode(recording.encoder, self._steps(scene, target, "correct", counts, named))

    def _expand(
        self, recording: Recording, scene: ResidentScene, target: Target, counts: Counts, named: dict[str, Handle]
    ) -> None:
        """What the reference says is lacking, once a reference; of a picture anew when the splats changed."""
        assert self.reference is not None
        # a render from the reference camera depends on splats and the client's resolution; a difference on nothing
        seen = (scene.changes, self.camera.intrinsics, self.options) if self.reference.picture else ()
        holds = (id(self.reference.coded), self.reference.knee, scene.kept_version, seen)
        if scene.held is not None and scene.held[1] == holds:
            return
        scene.gpu.device.queue.write_buffer(named["coded"], 0, np.ascontiguousarray(self.reference.coded, np.float32))
        own = target
        if self.reference.picture:  # the frame is drawn by now: the workspace is free again
            own = scene.record(recording, self.reference.camera, self._own_drawing, role="own")
        bound = named | {"own": own["picture"]}  # of a difference it is bound and not read
        encode(recording.encoder, build(scene.gpu, "expand", counts, {}, bound.__getitem__))
        # the reference is kept too: its address may not be another's while it is compared with
        recording.once_submitted.append(lambda: scene.hold(self.reference, holds))

    def _steps(
        self, scene: ResidentScene, target: Target, graph: str, counts: Counts, named: dict[str, Handle]
    ) -> list[Dispatch]:
        reference = self.reference and (self.reference.camera.width_px, self.reference.camera.height_px)
        stride = counts.get("sampled_x", 0)
        key = (graph, self.floats, reference, stride, self._veto_cell == 1, scene.kept_version)

        def make() -> list[Dispatch]:
            flags = {"floats": self.floats}
            return build(scene.gpu, graph, counts, flags, lambda name: named.get(name) or target[name])

        return target.steps(scene.workspace.version, key, make)

    @property
    def _veto_cell(self) -> int:
        """Pixels a side of the veto's values; 0 where there is none."""
        if self.veto is None:
            return 0
        return 1 if self.veto.shape == (self.camera.height_px, self.camera.width_px) else VETO_CELL_PX

    def _job(self) -> bytes:
        size = self.camera.width_px, self.camera.height_px
        if self.reference is None:
            return CORRECTION.pack(size=size)
        camera, settings = self.reference.camera, self.settings
        placement = Placement(self.camera, camera)
        m = placement.matrix
        return CORRECTION.pack(
            m0=m[0],
            m1=m[1],
            m2=m[2],
            size=size,
            reference=(camera.width_px, camera.height_px),
            cell=placement.cell_px,
            stride=placement.stride,
            tolerance=settings.depth_tolerance,
            slope_cells=settings.slope_cells,
            border=settings.border_px,
            hole_alpha=settings.hole_alpha,
            knee=self.reference.knee,
            grid=(-(-size[0] // CELL_PX), -(-size[1] // CELL_PX)),
            kind=int(self.reference.picture),
            veto_cell=self._veto_cell,
        )


def _reference_counts(client: Camera, camera: Camera) -> dict[str, int]:
    width, height = camera.width_px, camera.height_px
    stride = Placement(client, camera).stride
    return {
        "sampled_x": -(-client.width_px // stride),
        "sampled_y": -(-client.height_px // stride),
        "reference_x": width,
        "reference_y": height,
        "reference_pixels": width * height,
        "reference_places": 2 * (width + 1) * (height + 1),
    }


def _as_bytes(rgb: F32) -> Pixels:
    out = np.full((*rgb.shape[:2], 4), 255, np.uint8)
    out[..., :3] = np.floor(np.clip(rgb, 0, 1) * 255 + 0.5)
    return out
