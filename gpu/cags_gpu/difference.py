"""The server's references on the device: truth, the client's copy and what it lacks, of many clients in one submission.

Comparisons that wait for the device are gathered: whoever gets it draws all that fit together (:mod:`cags_gpu.layers`),
and the others find theirs done.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cags_common.correction.compander import compand_by_table
from cags_common.correction.views import Look
from cags_common.geometry import F32, Camera
from cags_common.raster.base import DepthKind, Footprint, RenderOptions
from cags_gpu.device import DeviceLostError
from cags_gpu.graph import build, encode
from cags_gpu.layers import Layer, most_layers, record_layers
from cags_gpu.layout import COMPAND
from cags_gpu.scene import KEPT_TARGETS, SceneOnDevice, Target
from cags_gpu.submission import Output, Outputs, Recording, Submission, read_back, submitted
from cags_gpu.workspace import LAYERS, TooLargeError, Workspace

_log = logging.getLogger(__name__)

Bytes: TypeAlias = NDArray[np.uint8]

BUFFERS = {Look.TRUTH: "truth_seen", Look.LACK: "lack_seen", Look.COMPANDED: "coded_seen"}
SEEN_BYTES = 12
"""Of a pixel: three floats."""

IN_FLIGHT = 3
"""Submissions on their way: while the device draws one, the next is recorded, and the last is read."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """What is drawn and compared, how it is companded, and which pictures are wanted at once; both scenes hold splats
    and are on one device. ``options`` ask for contributions, and for no depth.
    """

    truth: SceneOnDevice
    held: SceneOnDevice
    camera: Camera
    options: RenderOptions
    knee: float
    looks: tuple[Look, ...]

    @cached_property
    def kind(self) -> tuple[object, ...]:
        """Comparisons of one kind can be drawn together: they differ in scenes, cameras and footprints."""
        size = self.camera.width_px, self.camera.height_px, len(self.truth), len(self.held)
        return *size, replace(self.options, footprint=Footprint.classic()), self.knee, self.looks

    @property
    def pixels(self) -> int:
        """Of each picture."""
        return self.camera.width_px * self.camera.height_px


class DeviceViews:
    """The pictures of a comparison: some have come, the rest is on the device as long as this lives.

    Once the device is lost they are those of the scenes as they are then, drawn by the CPU.
    """

    compared = True

    def __init__(self, job: Comparison, workspace: Workspace, target: Target, layer: int) -> None:
        self._job, self._workspace, self._target, self._layer = job, workspace, target, layer
        self._read: dict[Look, F32] = {}
        self.depth: F32 = np.zeros((0, 0), np.float32)
        self.contribution: F32 = np.zeros(0, np.float32)

    def take(self, seen: Sequence[Bytes], depth: Bytes, contribution: Bytes) -> None:
        """What has come: the pictures that were asked for, the mirror's depth, the truth's contributions."""
        self._read = {look: self._picture(come) for look, come in zip(self._job.looks, seen, strict=True)}
        self.depth = depth.view(np.float32).reshape(self._shape)
        self.contribution = contribution.view(np.float32)

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
            size = SEEN_BYTES * self._job.pixels
            try:
                with self._workspace.gpu.used():
                    come = read_back(self._workspace, self._target[BUFFERS[look]], size, self._layer * size)
            except DeviceLostError:
                return self._anew[look]
            self._read[look] = self._picture(come)
        return self._read[look]

    @property
    def _shape(self) -> tuple[int, int]:
        return self._job.camera.height_px, self._job.camera.width_px

    def _picture(self, come: Bytes) -> F32:
        return come.view(np.float32).reshape(*self._shape, 3)

    @cached_property
    def _anew(self) -> dict[Look, F32]:
        job = self._job
        truth, held = (
            np.clip(scene.render(job.camera, replace(job.options, contribution=False)).rgb, 0, 1)
            for scene in (job.truth, job.held)
        )
        lack = truth - held
        return {Look.TRUTH: truth, Look.LACK: lack, Look.COMPANDED: compand_by_table(lack, job.knee)}


@dataclass(eq=False)
class _Waiting:
    job: Comparison
    views: DeviceViews | None = None
    done: bool = False
    """Whether the views are there, or were lost with the device."""
    turn: threading.Event = field(default_factory=threading.Event)
    """Set once it is done, or it is this one's turn to draw."""


class Comparisons:
    """Comparisons that wait for the device, and the buffers of their pictures. Safe to use from several threads.

    One thread records at a time, as much as can be drawn together, and wakes the first of the others to record next.
    Then it reads what was drawn, and wakes those whose views it made. Nobody waits for the device's lock before its
    turn: there those that are done would stand in the way of those to be drawn.
    """

    def __init__(self) -> None:
        self._waiting: list[_Waiting] = []
        self._recording = False
        self._lock = threading.Lock()
        self._flying = threading.BoundedSemaphore(IN_FLIGHT)
        self._most: dict[object, int] = {}
        """How many of a kind are drawn together, where the device's buffers hold fewer than was thought."""
        self._targets: list[tuple[Workspace, tuple[int, int, int, str], Target]] = []  # least recently used first

    def views(self, job: Comparison) -> DeviceViews | None:
        """The pictures; None where the device does not make them now."""
        mine = _Waiting(job)
        with self._lock:
            self._waiting.append(mine)
            leads, self._recording = not self._recording, True
        if not leads:
            mine.turn.wait()
        if not mine.done:
            with self._flying:
                self._make(mine)
        return mine.views

    def _make(self, mine: _Waiting) -> None:
        try:
            flight = mine.job.truth.on_device(lambda truth: self._begun(mine, truth.workspace), lambda _: None)
        finally:
            self._pass_on(mine)
        if flight is None:
            return
        try:
            flight.land()
        except (DeviceLostError, TooLargeError) as error:
            _log.info("comparisons are made step by step: %s", error)
            if isinstance(error, TooLargeError):
                self._fewer(flight.waiting)
        finally:
            for waiting in flight.waiting:
                waiting.done = True
                waiting.turn.set()

    def _pass_on(self, mine: _Waiting) -> None:
        with self._lock:
            self._waiting = [other for other in self._waiting if other is not mine]
            self._recording = bool(self._waiting)
            if self._waiting:
                self._waiting[0].turn.set()

    def _begun(self, mine: _Waiting, workspace: Workspace) -> _Flight:
        """Called with the device's lock held."""
        together = self._together(mine, workspace)
        try:
            return _Flight(together, workspace, self._spare)
        except BaseException as error:
            with self._lock:
                self._waiting[:0] = together[1:]
            if not isinstance(error, TooLargeError) or len(together) == 1:
                raise
        self._fewer(together)
        return _Flight([mine], workspace, self._spare)

    def _fewer(self, together: Sequence[_Waiting]) -> None:
        self._most[together[0].job.kind] = max(1, len(together) // 2)

    def _together(self, mine: _Waiting, workspace: Workspace) -> list[_Waiting]:
        """Take those out that can be drawn with ``mine``."""
        splats = max(len(mine.job.truth), len(mine.job.held))
        most = min(self._most.get(mine.job.kind, LAYERS), most_layers(splats, workspace.gpu.max_binding_bytes))
        with self._lock:
            alike = (other for other in self._waiting if other is not mine and other.job.kind == mine.job.kind)
            others = islice((other for other in alike if _loaded(other.job, workspace)), most - 1)
            together = [mine, *others]
            self._waiting = [other for other in self._waiting if other not in together]
        return together

    def _spare(self, workspace: Workspace, camera: Camera, count: int, role: str) -> Target:
        """Buffers of ``count`` or more pictures that nobody looks at any more; called with the device's lock held."""
        room = 1 << (count - 1).bit_length()
        key = camera.width_px, camera.height_px, room, role
        spare = (t for w, k, t in self._targets if w is workspace and k == key and not t.held)
        found = next(spare, None) or Target(workspace.gpu, camera, room)
        kept = [held for held in self._targets if held[0] is workspace and held[2] is not found]
        self._targets = [*kept[-KEPT_TARGETS + 1 :], (workspace, key, found)]
        return found


class _Flight:
    """Comparisons that are drawn together, submitted."""

    def __init__(
        self, waiting: Sequence[_Waiting], workspace: Workspace, spare: Callable[[Workspace, Camera, int, str], Target]
    ) -> None:
        self.waiting, self._workspace = waiting, workspace
        jobs, count = [one.job for one in waiting], len(waiting)
        self._seen, self._mirror = (spare(workspace, jobs[0].camera, count, role) for role in ("seen", "mirror"))
        self._made = [DeviceViews(job, workspace, self._seen, layer) for layer, job in enumerate(jobs)]
        self._seen.hold_for(*self._made)
        self._submission = Submission(workspace, self._recorded)

    def land(self) -> None:
        """Wait for the pictures and hand them out. Raises :class:`DeviceLostError` or :class:`TooLargeError`."""
        gpu = self._workspace.gpu
        with gpu.watched():
            outputs, wanted = self._submission.read()
        missed = wanted > self._submission.capacity
        if missed or self._workspace.crowded(wanted):
            with gpu.used():
                self._workspace.grow(wanted)
                if missed:
                    outputs = submitted(self._workspace, self._recorded)
        count = len(self.waiting)
        for layer, (waiting, views) in enumerate(zip(self.waiting, self._made, strict=True)):
            *pictures, depth, contribution = outputs[layer::count]
            views.take(pictures, depth, contribution)
            waiting.views = views

    def _recorded(self, recording: Recording) -> Outputs:
        workspace, jobs = self._workspace, [waiting.job for waiting in self.waiting]
        count, front = len(jobs), jobs[0]
        # the mirrors last and without contributions: those of the truths stay where they are
        truths = [Layer(job.truth.on(workspace), job.camera, job.options) for job in jobs]
        record_layers(recording, self._seen, truths)
        copies = [Layer(job.held.on(workspace), job.camera, _of_the_copy(job.options)) for job in jobs]
        record_layers(recording, self._mirror, copies, first_view=LAYERS)
        _compand(recording, workspace, jobs, (self._seen, self._mirror))
        pictures = [Output(self._seen[BUFFERS[look]], SEEN_BYTES * count * front.pixels, count) for look in front.looks]
        contributions = Output(workspace["contribution"], 4 * count * len(front.truth), count)
        return [*pictures, Output(self._mirror["depth"], 4 * count * front.pixels, count), contributions]


def _of_the_copy(options: RenderOptions) -> RenderOptions:
    return replace(options, contribution=False, depth=DepthKind.EXPECTED)


def _compand(
    recording: Recording, workspace: Workspace, jobs: Sequence[Comparison], targets: tuple[Target, Target]
) -> None:
    """Record what follows the drawings of truths and mirrors into their ``targets``."""
    seen, mirror = targets
    width, height = jobs[0].camera.width_px, len(jobs) * jobs[0].camera.height_px
    job = seen.uniform("compand_job", COMPAND.pack(size=(width, height), knee=jobs[0].knee))
    named = {"compand_job": job, "truth": seen["picture"], "mirror": mirror["picture"]}
    counts = {"pixels_x": width, "pixels_y": height}
    steps = seen.steps(
        workspace.version,
        ("compand", len(jobs), mirror),
        lambda: build(workspace.gpu, "compand", counts, {}, lambda name: named.get(name) or seen[name]),
    )
    encode(recording.encoder, steps)


def _loaded(job: Comparison, workspace: Workspace) -> bool:
    """Whether the scenes are in the device's memory; what cannot be is its own caller's to know."""
    try:
        job.truth.on(workspace)
        job.held.on(workspace)
    except TooLargeError:
        return False
    return True
