"""Times of the stages of a displayed frame on this machine, and the settings that follow."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from typing import TYPE_CHECKING

import numpy as np

from cags_common.geometry import F32, Camera, Intrinsics, Pose

if TYPE_CHECKING:
    from cags_common.correction import Reference
    from cags_common.raster.base import RasterScene, RenderOptions
    from cags_common.splats import Splats
    from cags_gpu.raster import GpuScene

SCENE = "procedural:size={splats},frames=1"
NATIVE_SPLATS, READABLE_SPLATS = 30_000, 2_000
"""The first is the size of the demo's scene."""
SIZES = ((400, 300), (640, 480), (800, 600), (1600, 1200))
READABLE_SIZES = ((320, 240),)
WARM_UPS, REPETITIONS = 1, 5
FRAME_MS = 1000.0 / 30.0
DRAW_SHARE = 0.6
"""Share of a frame's time for drawing; decoding and the page need the rest."""

CORRECTED_MS = 1000.0 / 24.0
"""Time limit for a frame corrected by a new picture; differences take less."""

FPS = 30.0
KNEE = 0.12
"""Knee of the corrected differences."""

FLAWS = 0.05
"""Standard deviation of the errors added to the client's colours, so that there is something to correct."""

REFERENCE_SHARE = 0.6
"""Share of a frame's time that a reference may take on the server's threads."""


@dataclass(frozen=True, slots=True)
class SizeTimes:
    """Median milliseconds of each stage at one picture size.

    ``own``: the client's splats drawn from a reference's camera, once per new picture, and never for a difference.
    """

    width: int
    height: int
    raster_ms: float
    correct_ms: float
    own_ms: float
    gpu_draw_ms: float | None = None
    """Drawn by the graphics processor and read back; None without one."""
    gpu_total_ms: float | None = None
    """A frame corrected by a new picture, made in one go by the graphics processor; None without one."""

    @property
    def total_ms(self) -> float:
        """Time of a frame corrected by a new picture, without decoding."""
        return self.raster_ms + self.correct_ms + self.own_ms

    @property
    def drawn_ms(self) -> float:
        """Time to draw on the device chosen by ``--raster auto``."""
        return self.raster_ms if self.gpu_draw_ms is None else self.gpu_draw_ms

    @property
    def corrected_ms(self) -> float:
        """Time of a corrected frame on the device chosen by ``--raster auto``."""
        return self.total_ms if self.gpu_total_ms is None else self.gpu_total_ms


@dataclass(frozen=True, slots=True)
class Timings:
    """Results: ``splats`` in view, the server's reference, and the client at several sizes.

    For a reference the server draws the true view (``reference_ms``) and the client's view (``mirror_ms``), and codes
    the difference (``encode_ms``).
    """

    backend: str
    splats: int
    threads: int
    reference_ms: float
    mirror_ms: float
    encode_ms: float
    sizes: tuple[SizeTimes, ...]
    adapter: str = ""
    """Name of the graphics processor; empty without one."""
    gpu_reference_ms: float | None = None
    """True view, client's view and their difference in one go on the graphics processor."""

    @property
    def server_ms(self) -> float:
        """Time of a reference on the device chosen by ``--rasteriser auto``."""
        drawn = self.reference_ms + self.mirror_ms if self.gpu_reference_ms is None else self.gpu_reference_ms
        return drawn + self.encode_ms


@dataclass(frozen=True, slots=True)
class Advice:
    """Recommended settings for this machine, as flags of the two commands, and the reason."""

    server: str
    client: str
    reason: str


def measure(threads: int) -> Timings:
    """Time one scene at several sizes: a few seconds with the kernels, half a minute without."""
    from cags_common import raster
    from cags_common.correction import Reference, compand
    from cags_common.raster.base import DepthKind, RenderOptions
    from cags_encoder.scenes import open_scene

    rasteriser = raster.create()
    native = rasteriser.name != "oracle"
    splats = NATIVE_SPLATS if native else READABLE_SPLATS
    source = open_scene(SCENE.format(splats=splats))
    truth, focus = source.frame(0), source.focus
    scene, flawed = rasteriser.load(truth), _flawed(truth)
    eye = np.asarray(focus.centre) + np.array([0.6, 0.4, 1.0]) * focus.radius * 1.4
    pose = Pose.looking_at((float(eye[0]), float(eye[1]), float(eye[2])), focus.centre, source.up)
    sizes = SIZES if native else READABLE_SIZES
    reference = _camera(400, 300, pose)
    options = RenderOptions(threads=threads, depth=DepthKind.NONE)
    seeing = replace(options, contribution=True)
    held = rasteriser.load(flawed)
    pictures = [
        (scene.render(camera, options).rgb, held.render(camera, options).rgb)
        for camera in (reference, reference.at(_beside(pose)))
    ]
    gpu = _on_gpu(truth, flawed)
    picture = Reference(pictures[0][0].clip(0, 1), reference, picture=True)
    difference = Reference(compand(np.subtract(*pictures[0]), KNEE).astype(np.float32), reference, knee=KNEE)
    times = [_at_size(held, _camera(w, h, pose), difference, threads) for w, h in sizes]
    return Timings(
        backend=rasteriser.name,
        splats=splats,
        threads=threads,
        reference_ms=median_ms(lambda: scene.render(reference, seeing)),
        mirror_ms=median_ms(lambda: held.render(reference, options)),
        encode_ms=_coding_ms(pictures, reference.intrinsics),
        sizes=tuple(_with_gpu(each, gpu, pose, picture) for each in times),
        adapter="" if gpu is None else gpu.adapter,
        gpu_reference_ms=None if gpu is None else _gpu_reference_ms(gpu, reference, seeing),
    )


def _flawed(splats: Splats) -> Splats:
    """``splats`` with errors of colour, as a client may hold them."""
    errors = np.random.default_rng(0).normal(0.0, FLAWS, splats.sh0.shape)
    return replace(splats, sh0=splats.sh0 + np.float32(errors))


def _beside(pose: Pose) -> Pose:
    """A pose a small step away, so that successive references differ."""
    x, y, z = pose.position
    return Pose((x + 0.01, y, z), pose.rotation)


def _coding_ms(pictures: Sequence[tuple[F32, F32]], intrinsics: Intrinsics) -> float:
    """Time to code the difference between the true and the client's view, mean over the pairs."""
    from cags_protocol.wire.limits import PROTOCOL_VERSION
    from cags_protocol.wire.messages import Hello
    from cags_server.reference.coder import ReferenceCoder
    from cags_server.settings import ServerSettings

    settings = ServerSettings(
        references="difference", reference_width=intrinsics.width_px, reference_height=intrinsics.height_px
    )
    coder = ReferenceCoder(settings, Hello(PROTOCOL_VERSION, intrinsics, Pose.identity()), FPS)
    turn = cycle(pictures)
    return median_ms(lambda: coder.code(*next(turn), idr=False))


@dataclass(frozen=True, slots=True)
class _OnGpu:
    """The true scene and a client's copy on the graphics processor, and the name of the processor."""

    truth: GpuScene
    held: GpuScene
    adapter: str


def _on_gpu(truth: Splats, held: Splats) -> _OnGpu | None:
    """Load both on the graphics processor; None without one."""
    from cags_common.errors import ConfigError
    from cags_gpu.device import choose
    from cags_gpu.raster import GpuRasteriser

    try:
        rasteriser = GpuRasteriser()
        return _OnGpu(rasteriser.load(truth), rasteriser.load(held), str(choose()[0]))
    except ConfigError:
        return None


def _with_gpu(times: SizeTimes, gpu: _OnGpu | None, pose: Pose, picture: Reference) -> SizeTimes:
    """``times`` with those of the graphics processor added; every corrected frame has a new ``picture``."""
    if gpu is None:
        return times
    from cags_common.raster.base import RenderOptions
    from cags_gpu.correct import shown

    camera, options = _camera(times.width, times.height, pose), RenderOptions()
    return replace(
        times,
        gpu_draw_ms=median_ms(lambda: shown(gpu.held, camera, options, None)),
        gpu_total_ms=median_ms(lambda: shown(gpu.held, camera, options, replace(picture, coded=picture.coded.copy()))),
    )


def _gpu_reference_ms(gpu: _OnGpu, camera: Camera, options: RenderOptions) -> float:
    from cags_common.correction import Look

    looks = Look.LACK, Look.COMPANDED
    return median_ms(lambda: gpu.truth.compared(gpu.held, camera, options, knee=KNEE, looks=looks))


def _at_size(scene: RasterScene, camera: Camera, reference: Reference, threads: int) -> SizeTimes:
    """Times at one size. Every frame gets a new reference, so nothing about it is cached."""
    from cags_common import correction
    from cags_common.raster.base import DepthKind, Footprint, RenderOptions

    options = RenderOptions(threads=threads)
    view = scene.render(camera, options)
    footprint = Footprint.of(camera.intrinsics, reference.camera.intrinsics)
    own_options = replace(options, depth=DepthKind.NONE, footprint=footprint)
    corrector = correction.create("auto", threads)
    return SizeTimes(
        camera.width_px,
        camera.height_px,
        median_ms(lambda: scene.render(camera, options)),
        median_ms(lambda: corrector.correct(view, camera, replace(reference))),
        median_ms(lambda: scene.render(reference.camera, own_options)),
    )


def _camera(width: int, height: int, pose: Pose) -> Camera:
    fov_x = math.radians(60)
    fov_y = 2 * math.atan(math.tan(fov_x / 2) * height / width)
    return Camera(Intrinsics.of_fov(width, height, fov_x, fov_y), pose)


def median_ms(work: Callable[[], object]) -> float:
    """Median wall time of ``work`` after a warm-up."""
    for _ in range(WARM_UPS):
        work()
    times = []
    for _ in range(REPETITIONS):
        start = time.perf_counter()
        work()
        times.append((time.perf_counter() - start) * 1e3)
    return statistics.median(times)


def advise(timings: Timings) -> Advice:
    """Recommend the largest picture that is drawn in time and corrected at 24 frames per second.

    If no size is corrected in time but one is drawn, the client may halve its pixels while frames take too long.
    """
    every = max(1, math.ceil(timings.server_ms / (FRAME_MS * REFERENCE_SHARE)))
    server = f"--render-threads {timings.threads}" + (f" --reference-every {every}" if every > 1 else "")
    drawn = [size for size in timings.sizes if size.drawn_ms <= FRAME_MS * DRAW_SHARE]
    corrected = [size for size in drawn if size.corrected_ms <= CORRECTED_MS]
    scene = f"at {timings.splats:,} splats" + (" on the GPU" if timings.adapter else "")
    if not drawn:
        least = min(timings.sizes, key=lambda s: s.width)
        reason = f"{least.drawn_ms:.0f} ms to draw a frame {scene}: too slow for 30 frames per second"
        return Advice(server, _flags(least, timings, "--restore none --exactness fast"), reason)
    best = max(corrected or drawn, key=lambda s: s.width)
    reason = f"{scene} a frame takes {best.drawn_ms:.0f} ms, a corrected frame {best.corrected_ms:.0f} ms"
    return Advice(server, _flags(best, timings, f"--resolution {'full' if corrected else 'auto'}"), reason)


def _flags(size: SizeTimes, timings: Timings, more: str) -> str:
    return f"--width {size.width} --height {size.height} {more} --threads {timings.threads}"
