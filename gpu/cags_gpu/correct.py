"""The client's whole frame on the device: what is read back is what is shown, the rest when somebody looks at it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cags_common.correction import Correction, oracle
from cags_common.correction.base import (
    CELL_PX,
    VETO_CELL_PX,
    Corrected,
    CorrectSettings,
    Placement,
    Reference,
    checked_veto,
    veto_shape,
)
from cags_common.correction.changed import BEHIND, cell_boxes
from cags_common.geometry import F32, Camera
from cags_common.raster.base import DepthKind, RenderOptions
from cags_common.raster.checks import check_camera
from cags_common.raster.halving import enlarged
from cags_gpu.device import Handle
from cags_gpu.graph import Counts, Dispatch, buffer_bytes, build, encode
from cags_gpu.layout import CHANGED, COMPARE, CORRECTION, ENLARGE
from cags_gpu.scene import ResidentScene, SceneOnDevice, Target, packed
from cags_gpu.submission import Output, Outputs, Recording, submitted

Pixels = NDArray[np.uint8]

LEAST_BOXES = 64
"""Changed splats for which there is room at first."""

DISPLAY = "display"
"""Role of the buffer that a frame is brought up into."""


def shown(
    scene: SceneOnDevice,
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
    frame = Frame(camera, options, _correction(camera, reference, settings), veto)
    if not len(scene):
        return _as_bytes(frame.on_cpu(scene).rgb)

    def draw(resident: ResidentScene) -> Pixels:
        return frame.draw(resident, frame.target_of(resident)).reshape(camera.height_px, camera.width_px, 4)

    return scene.on_device(draw, lambda _: _as_bytes(frame.on_cpu(scene).rgb))


def corrected(
    scene: SceneOnDevice,
    camera: Camera,
    options: RenderOptions,
    reference: Reference | None,
    settings: CorrectSettings | None = None,
    *,
    veto: F32 | None = None,
) -> Corrected:
    """As :func:`shown`, as floats, with the confidence."""
    frame = Frame(camera, options, _correction(camera, reference, settings), veto, floats=True)
    if not len(scene):
        return frame.on_cpu(scene)

    def draw(resident: ResidentScene) -> Corrected:
        rgba = frame.draw(resident, frame.target_of(resident)).view(np.float32)
        rgba = rgba.reshape(camera.height_px, camera.width_px, 4)
        return Corrected(np.ascontiguousarray(rgba[..., :3]), np.ascontiguousarray(rgba[..., 3]))

    return scene.on_device(draw, lambda _: frame.on_cpu(scene))


def _correction(camera: Camera, reference: Reference | None, settings: CorrectSettings | None) -> Correction | None:
    if reference is None:
        return None
    return Correction(reference, camera.intrinsics, settings or CorrectSettings())


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame of a client, however it is made."""

    camera: Camera
    options: RenderOptions
    correction: Correction | None
    given_veto: F32 | None = None
    """In place of what the correction says of changes and age."""
    floats: bool = False
    confidence: bool = False
    """Whether bytes hold it in the place of their alpha."""
    display: Camera | None = None
    """The display's camera, if this one has half its size and the picture is to be enlarged."""

    def __post_init__(self) -> None:
        check_camera(self.camera)
        if self.given_veto is not None:
            checked_veto(self.given_veto, self.camera)

    @property
    def drawing(self) -> RenderOptions:
        """How the client's own picture is drawn: where it is corrected, thin pixels have no depth."""
        if self.correction is None:
            return replace(self.options, contribution=False)
        thin = max(self.options.void_alpha, self.correction.settings.hole_alpha)
        return replace(self.options, depth=DepthKind.EXPECTED, contribution=False, void_alpha=thin)

    @property
    def compact(self) -> bool:
        """Whether the client's own picture is kept in 16 bits a channel: nobody but a display sees it."""
        return self.options.displayed and packed(self.options)

    def on_cpu(self, scene: SceneOnDevice) -> Corrected:
        """The frame by the definition."""
        view = scene.render(self.camera, self.drawing)
        if self.correction is None:
            made = Corrected(np.clip(view.rgb, 0, 1), np.zeros(view.alpha.shape, np.float32))
        else:
            ref, own = self.correction.reference, None
            if ref.picture:
                own = scene.render(ref.camera, self.correction.own_drawing(self.options)).rgb
            veto = self.correction.veto(view, self.camera) if self.given_veto is None else self.given_veto
            made = oracle.correct(view, self.camera, ref, own, self.correction.settings, veto=veto)
        if self.display is None:
            return made
        return replace(made, rgb=enlarged(made.rgb, self.display, self.options.threads))

    def target_of(self, scene: ResidentScene, role: str = "") -> Target:
        """The buffers that the frame is drawn into."""
        return scene.target(self.camera, role)

    def draw(self, scene: ResidentScene, target: Target) -> Pixels:
        """Bytes of what is shown, once the device has drawn it into ``target``."""
        whole = self.display or self.camera
        size = (16 if self.floats else 4) * whole.height_px * whole.width_px

        def record(recording: Recording) -> Outputs:
            scene.record_into(recording, target, self.camera, self.drawing, compact=self.compact)
            self._finish(recording, scene, target)
            if self.display is None:
                return [Output(target[self._output], size)]
            return [Output(self._brought_up(recording, scene, target, self.display), size)]

        (out,) = submitted(scene.workspace, record)
        return out

    @property
    def _whole_floats(self) -> bool:
        return self.floats or self.display is not None

    @property
    def _output(self) -> str:
        return "shown_floats" if self._whole_floats else "shown"

    def _brought_up(self, recording: Recording, scene: ResidentScene, target: Target, display: Camera) -> Handle:
        whole, size = scene.target(display, DISPLAY), (display.width_px, display.height_px)
        job = scene.gpu.uniform(ENLARGE.pack(size=size, half=(self.camera.width_px, self.camera.height_px)))
        named = {"enlarge_job": job, "small": target[self._output], "shown": whole["shown"]}
        steps = target.steps(
            scene.workspace.version,
            ("enlarge", size, whole),
            lambda: build(scene.gpu, "enlarge", whole.counts, {}, named.__getitem__),
        )
        encode(recording.encoder, steps)
        return whole["shown"]

    def _finish(self, recording: Recording, scene: ResidentScene, target: Target) -> None:
        """What follows the drawing: the picture as it is, or with what the reference says is lacking."""
        named = {"correction": target.uniform("correction", self._job()), "shown": target[self._output]}
        if self.correction is None:
            encode(recording.encoder, self._steps(scene, target, "plain", target.counts, named))
            return
        counts = target.counts | _reference_counts(self.camera, self.correction.reference.camera)
        kept = buffer_bytes("reference", counts)
        named |= {name: scene.kept(name, size) for name, size in kept.items()}
        named["veto"] = target["veto_pixels" if self._veto_cell == 1 else "veto_cells"]
        self._take_away(recording, scene, target, named)
        self._expand(recording, scene, target, counts, named)
        encode(recording.encoder, self._steps(scene, target, "correct", counts, named))

    def _take_away(self, recording: Recording, scene: ResidentScene, target: Target, named: dict[str, Handle]) -> None:
        """The veto: as it was given, or where the picture shows what changed."""
        given = self.correction
        assert given is not None
        if self.given_veto is None and given.changed is not None:
            self._look_for_changes(recording, scene, target, named)
            return
        veto = self.given_veto
        if veto is None and given.stale > 0:
            veto = np.full(veto_shape(self.camera), given.stale)
        if veto is not None:
            scene.gpu.device.queue.write_buffer(named["veto"], 0, np.ascontiguousarray(veto, np.float32))

    def _look_for_changes(
        self, recording: Recording, scene: ResidentScene, target: Target, named: dict[str, Handle]
    ) -> None:
        assert self.correction is not None
        assert self.correction.changed is not None
        near, cells = cell_boxes(self.correction.changed, self.camera)
        packed = np.zeros((len(near), 4), np.uint32)
        packed[:, 0], packed[:, 1] = cells[:, 0] | cells[:, 1] << 16, cells[:, 2] | cells[:, 3] << 16
        packed[:, 2] = near.astype(np.float32).view(np.uint32)
        room = max(LEAST_BOXES, 1 << len(near).bit_length())
        boxes = scene.kept("boxes", buffer_bytes("reference", {"boxes": room})["boxes"])
        if len(near):
            scene.gpu.device.queue.write_buffer(boxes, 0, packed)
        rows, columns = veto_shape(self.camera)
        size = self.camera.width_px, self.camera.height_px
        job = CHANGED.pack(size=size, grid=(columns, rows), count=len(near), behind=BEHIND, stale=self.correction.stale)
        found = {**named, "changed_job": target.uniform("changed", job), "boxes": boxes}
        encode(recording.encoder, self._steps(scene, target, "changed", target.counts, found))

    def _expand(
        self, recording: Recording, scene: ResidentScene, target: Target, counts: Counts, named: dict[str, Handle]
    ) -> None:
        """What the reference says is lacking, once a reference; of a picture anew when the splats changed."""
        assert self.correction is not None
        ref = self.correction.reference
        # the render from the reference camera depends on splats and the client's resolution; a difference on nothing
        seen = (scene.changes, self.correction.client, self.options, ref.error) if ref.picture else ()
        holds = (id(ref.coded), ref.knee, scene.kept_version, seen)
        if scene.held is not None and scene.held[1] == holds:
            return
        scene.gpu.device.queue.write_buffer(named["coded"], 0, np.ascontiguousarray(ref.coded, np.float32))
        bound = dict(named)
        if ref.picture:  # the frame is drawn by now: the workspace is free again
            own = scene.record(recording, ref.camera, self.correction.own_drawing(self.options), role="own")
            job = COMPARE.pack(size=(ref.camera.width_px, ref.camera.height_px), error=ref.error)
            bound |= {"own": own["picture"], "compare_job": target.uniform("compare", job)}
        graph = "compare" if ref.picture else "expand"
        encode(recording.encoder, build(scene.gpu, graph, counts, {}, bound.__getitem__))
        # the reference is kept too: its address may not be another's while it is compared with
        recording.once_drawn.append(lambda: scene.hold(ref, holds))

    def _steps(
        self, scene: ResidentScene, target: Target, graph: str, counts: Counts, named: dict[str, Handle]
    ) -> list[Dispatch]:
        ref = self.correction and self.correction.reference.camera
        size = ref and (ref.width_px, ref.height_px)
        stride = counts.get("sampled_x", 0)
        flags = {"compact": self.compact, "floats": self._whole_floats, "confidence": self.confidence}
        key = (graph, *flags.values(), size, stride, self._veto_cell == 1, scene.kept_version)
        return target.steps(
            scene.workspace.version,
            key,
            lambda: build(scene.gpu, graph, counts, flags, lambda name: named.get(name) or target[name]),
        )

    @property
    def _veto_cell(self) -> int:
        """Pixels a side of the veto's values; 0 where there is none."""
        if self.given_veto is not None:
            return 1 if self.given_veto.shape == (self.camera.height_px, self.camera.width_px) else VETO_CELL_PX
        given = self.correction
        return VETO_CELL_PX if given is not None and (given.changed is not None or given.stale > 0) else 0

    def _job(self) -> bytes:
        size = self.camera.width_px, self.camera.height_px
        if self.correction is None:
            return CORRECTION.pack(size=size)
        ref, settings = self.correction.reference, self.correction.settings
        placement = Placement(self.camera, ref.camera)
        m = placement.matrix
        return CORRECTION.pack(
            m0=m[0],
            m1=m[1],
            m2=m[2],
            size=size,
            reference=(ref.camera.width_px, ref.camera.height_px),
            cell=placement.cell_px,
            stride=placement.stride,
            tolerance=settings.depth_tolerance,
            slope_cells=settings.slope_cells,
            border=settings.border_px,
            hole_alpha=settings.hole_alpha,
            knee=ref.knee,
            grid=(-(-size[0] // CELL_PX), -(-size[1] // CELL_PX)),
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
        "reference_groups": -(-width // 16) * -(-height // 16),
    }


def _as_bytes(rgb: F32) -> Pixels:
    out = np.full((*rgb.shape[:2], 4), 255, np.uint8)
    out[..., :3] = np.floor(np.clip(rgb, 0, 1) * 255 + 0.5)
    return out
