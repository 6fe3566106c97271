"""How long the stages of a displayed frame take here, and which settings follow from that."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from cags_common.geometry import Camera, Intrinsics, Pose

if TYPE_CHECKING:
    from cags_common.splats import Splats
    from cags_gpu.raster import GpuScene

SCENE = "procedural:size={splats},frames=1"
NATIVE_SPLATS, READABLE_SPLATS = 30_000, 2_000
"""The first is the demo's scene."""
SIZES = ((400, 300), (640, 480), (800, 600), (1600, 1200))
READABLE_SIZES = ((320, 240),)
WARM_UPS, REPETITIONS = 1, 5
FRAME_MS = 1000.0 / 30.0
DRAW_SHARE = 0.6
"""Of a frame's time that drawing may take: decoding and the page want the rest."""

RESTORED_MS = 1000.0 / 24.0
"""A frame that is restored may take: those are the first ones of a scene, and those of slow links."""

REFERENCE_SHARE = 0.6
"""Of a frame's time that a reference may take the server's threads."""


@dataclass(frozen=True, slots=True)
class SizeTimes:
    """Median milliseconds of each stage at one picture size; ``own``: the splats as the reference sees them."""

    width: int
    height: int
    raster_ms: float
    align_ms: float
    own_ms: float
    restore_ms: float
    gpu_ms: float | None = None
    """Drawn by the graphics processor and read back, where there is one."""

    @property
    def total_ms(self) -> float:
        """The display path without decoding, of a frame that is restored."""
        return self.raster_ms + self.align_ms + self.own_ms + self.restore_ms


@dataclass(frozen=True, slots=True)
class Timings:
    """What was measured: ``splats`` in view, the server's reference frame, and the client at several sizes."""

    backend: str
    splats: int
    threads: int
    reference_ms: float
    encode_ms: float
    sizes: tuple[SizeTimes, ...]
    adapter: str = ""
    """The graphics processor that was timed; empty where there is none."""


@dataclass(frozen=True, slots=True)
class Advice:
    """Settings that fit this machine, as flags of the two commands, and why."""

    server: str
    client: str
    reason: str


def measure(threads: int) -> Timings:
    """Time one scene at several sizes; a few seconds with the kernels, half a minute without."""
    from cags_common import raster
    from cags_common.raster.base import Footprint, RenderOptions
    from cags_common.video.h264 import H264Encoder
    from cags_encoder.scenes import open_scene

    rasteriser = raster.create()
    native = rasteriser.name != "reference"
    splats = NATIVE_SPLATS if native else READABLE_SPLATS
    source = open_scene(SCENE.format(splats=splats))
    scene, focus = rasteriser.load(source.frame(0)), source.focus
    eye = np.asarray(focus.centre) + np.array([0.6, 0.4, 1.0]) * focus.radius * 1.4
    pose = Pose.looking_at((float(eye[0]), float(eye[1]), float(eye[2])), focus.centre, source.up)
    sizes = SIZES if native else READABLE_SIZES
    reference = _camera(400, 300, pose)
    options = RenderOptions(threads=threads, contribution=True, footprint=Footprint.antialiased())
    view = scene.render(reference, options)
    gpu, adapter = _gpu_scene(source.frame(0))
    encoder = H264Encoder(400, 300, 30.0)
    return Timings(
        backend=rasteriser.name,
        splats=splats,
        threads=threads,
        reference_ms=median_ms(lambda: scene.render(reference, options)),
        encode_ms=median_ms(lambda: encoder.encode(np.clip(view.rgb, 0, 1))),
        sizes=tuple(_with_gpu(_at_size(scene, _camera(w, h, pose), reference, threads), gpu, pose) for w, h in sizes),
        adapter=adapter,
    )


def _gpu_scene(splats: Splats) -> tuple[GpuScene | None, str]:
    """The scene on the graphics processor, and that one's name; None and nothing where there is none."""
    from cags_common.errors import ConfigError
    from cags_gpu.device import choose
    from cags_gpu.raster import GpuRasteriser

    try:
        return GpuRasteriser().load(splats), str(choose()[0])
    except ConfigError:
        return None, ""


def _with_gpu(times: SizeTimes, scene: GpuScene | None, pose: Pose) -> SizeTimes:
    if scene is None:
        return times
    from cags_common.raster.base import RenderOptions
    from cags_gpu.correct import shown

    camera = _camera(times.width, times.height, pose)
    return replace(times, gpu_ms=median_ms(lambda: shown(scene, camera, RenderOptions(), None)))


def _at_size(scene: object, camera: Camera, reference: Camera, threads: int) -> SizeTimes:
    from cags_client import align, restore
    from cags_client.align import ReferencePicture
    from cags_client.restore import RestoreInput
    from cags_common.raster.base import Footprint, RasterScene, RenderOptions

    drawn: RasterScene = scene  # type: ignore[assignment]
    options = RenderOptions(threads=threads)
    view = drawn.render(camera, options)
    assert view.depth is not None
    depth = view.depth
    as_seen = RenderOptions(threads=threads, footprint=Footprint.antialiased())
    own = drawn.render(reference, as_seen)
    picture = ReferencePicture(np.clip(own.rgb, 0, 1), reference, 0)
    aligner, restorer = align.create("auto"), restore.create("affine")
    inputs = RestoreInput(np.clip(view.rgb, 0, 1), view.alpha, aligner.align(picture, depth, camera), picture, own)
    return SizeTimes(
        camera.width_px,
        camera.height_px,
        median_ms(lambda: drawn.render(camera, options)),
        median_ms(lambda: aligner.align(picture, depth, camera)),
        median_ms(lambda: drawn.render(reference, as_seen)),
        median_ms(lambda: restorer.restore(inputs.afresh())),
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
    """The largest picture that is drawn in time, and restored in the time of 24 frames a second.

    Where no size is restored in time but one is drawn, ``auto`` restores what frames have room for.
    """
    work = timings.reference_ms + timings.encode_ms
    every = max(1, math.ceil(work / (FRAME_MS * REFERENCE_SHARE)))
    server = f"--render-threads {timings.threads}" + (f" --reference-every {every}" if every > 1 else "")
    drawn = [size for size in timings.sizes if size.raster_ms <= FRAME_MS * DRAW_SHARE]
    restored = [size for size in drawn if size.total_ms <= RESTORED_MS]
    scene = f"at {timings.splats:,} splats"
    if not drawn:
        least = min(timings.sizes, key=lambda s: s.width)
        why = f"{least.raster_ms:.0f} ms to draw a frame {scene}: 30 a second are out of reach"
        return Advice(server, _flags(least, timings, "none") + " --exactness fast", why)
    best = max(restored or drawn, key=lambda s: s.width)
    why = f"{scene} a frame takes {best.raster_ms:.0f} ms, one that is restored {best.total_ms:.0f}"
    return Advice(server, _flags(best, timings, "affine" if restored else "auto"), why)


def _flags(size: SizeTimes, timings: Timings, tier: str) -> str:
    return f"--width {size.width} --height {size.height} --restore {tier} --threads {timings.threads}"
