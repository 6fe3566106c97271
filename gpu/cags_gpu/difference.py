"""The server's reference on the device: truth, the client's copy and what it lacks, in one submission."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cags_common.correction.compander import compand_by_table
from cags_common.correction.views import Look
from cags_common.geometry import F32, Camera
from cags_common.raster.base import DepthKind, RenderOptions
from cags_common.raster.checks import check_camera
from cags_gpu.device import DeviceLostError
from cags_gpu.graph import build, encode
from cags_gpu.layout import COMPAND
from cags_gpu.scene import ResidentScene, SceneOnDevice, Target
from cags_gpu.submission import Outputs, Recording, read_back, submitted

BUFFERS = {Look.TRUTH: "truth_seen", Look.LACK: "lack_seen", Look.COMPANDED: "coded_seen"}
SEEN_BYTES = 8
"""Of a pixel: three channels of 16 bits, and 16 to spare."""

MIRROR = "mirror"
"""Role of the buffers of the client's copy."""


def device_views(
    truth: SceneOnDevice, held: SceneOnDevice, job: Comparison, looks: Collection[Look]
) -> DeviceViews | None:
    """See :meth:`cags_common.correction.ComparingScene.compared`; both scenes are on one device."""
    check_camera(job.camera)
    if not (len(truth) and len(held)):
        return None

    def draw(resident: ResidentScene) -> DeviceViews:
        target = resident.target(job.camera, resident.spare_role(job.camera))
        made = DeviceViews((truth, held), job, resident, target)
        target.hold_for(made)
        made.take(looks, job.draw(resident, held.on(resident.workspace), target, looks))
        return made

    return truth.on_device(draw, lambda _: None)


class DeviceViews:
    """The pictures of a comparison: some have come, the rest is on the device as long as this lives.

    Once the device is lost they are those of the scenes as they are then, drawn by the CPU.
    """

    compared = True

    def __init__(
        self, scenes: tuple[SceneOnDevice, SceneOnDevice], job: Comparison, resident: ResidentScene, target: Target
    ) -> None:
        self._scenes, self._job, self._target = scenes, job, target
        self._workspace = resident.workspace
        self._read: dict[Look, F32] = {}
        self.depth: F32 = np.zeros((0, 0), np.float32)
        self.contribution: F32 = np.zeros(0, np.float32)

    def take(self, looks: Collection[Look], outputs: list[NDArray[np.uint8]]) -> None:
        """Read the outputs of :meth:`Comparison.draw` for ``looks``."""
        *seen, depth, contribution = outputs
        for look, out in zip(looks, seen, strict=True):
            self._read[look] = self._unpacked(look, out)
        camera = self._job.camera
        self.depth = depth.view(np.float32).reshape(camera.height_px, camera.width_px).copy()
        self.contribution = contribution.view(np.float32).copy()

    @property
    def truth(self) -> F32:
        """[h, w, 3] in [0, 1]."""
        return self._seen(Look.TRUTH)

    @property
    def lack(self) -> F32:
        """[h, w, 3] in [-1, 1]."""
        return self._seen(Look.LACK)

    def companded(self, knee: float) -> F32:
        """[h, w, 3]: of another knee than was foreseen by the CPU."""
        return self._seen(Look.COMPANDED) if knee == self._job.knee else compand_by_table(self.lack, knee)

    def _seen(self, look: Look) -> F32:
        if look not in self._read:
            size = SEEN_BYTES * self._job.camera.width_px * self._job.camera.height_px
            try:
                with self._workspace.gpu.used():
                    self._read[look] = self._unpacked(
                        look, read_back(self._workspace, self._target[BUFFERS[look]], size)
                    )
            except DeviceLostError:
                return self._anew[look]
        return self._read[look]

    @cached_property
    def _anew(self) -> dict[Look, F32]:
        job = self._job
        truth, held = (
            np.clip(scene.render(job.camera, replace(job.options, contribution=False)).rgb, 0, 1)
            for scene in self._scenes
        )
        lack = truth - held
        return {Look.TRUTH: truth, Look.LACK: lack, Look.COMPANDED: compand_by_table(lack, job.knee)}

    def _unpacked(self, look: Look, read: NDArray[np.uint8]) -> F32:
        camera = self._job.camera
        kind, most = (np.int16, 32767) if look is Look.LACK else (np.uint16, 65535)
        words = read.view(kind).reshape(camera.height_px, camera.width_px, 4)[..., :3]
        return np.multiply(words, np.float32(1 / most), dtype=np.float32)


@dataclass(frozen=True, eq=False)
class Comparison:
    """What is drawn, and how it is companded."""

    camera: Camera
    options: RenderOptions
    knee: float

    def draw(
        self, truth: ResidentScene, mirror: ResidentScene, target: Target, looks: Collection[Look]
    ) -> list[NDArray[np.uint8]]:
        """Bytes of ``looks``, then of the mirror's depth and of the truth's contributions."""
        width, height = self.camera.width_px, self.camera.height_px
        seen = [(target[BUFFERS[look]], SEEN_BYTES * width * height) for look in looks]

        def record(recording: Recording) -> Outputs:
            # the mirror last and without contributions: those of the truth stay where they are
            truth.record_into(recording, target, self.camera, replace(self.options, contribution=True))
            drawn = replace(self.options, contribution=False, depth=DepthKind.EXPECTED)
            held = mirror.record(recording, self.camera, drawn, role=MIRROR)
            job = target.uniform("compand_job", COMPAND.pack(size=(width, height), knee=self.knee))
            named = {"compand_job": job, "truth": target["picture"], "mirror": held["picture"]}
            steps = build(truth.gpu, "compand", target.counts, {}, lambda name: named.get(name) or target[name])
            encode(recording.encoder, steps)
            return [*seen, (held["depth"], 4 * width * height), (truth.workspace["contribution"], 4 * truth.count)]

        return submitted(truth.workspace, record)
