"""``cags-bench raster --backends cpu gpu``: backends against the definition, corrections, and the work of a frame."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from cags_bench.jsonl import check, provenance, summary
from cags_bench.raster.cases import interleaved, size_text, view_of
from cags_bench.raster.settings import RasterSettings
from cags_common import correction
from cags_common.correction import Correction, Reference, compand
from cags_common.correction.oracle import correct
from cags_common.geometry import F32, Camera, Intrinsics, Pose
from cags_common.raster import Exactness, RasterScene, RenderedView, RenderOptions, create
from cags_common.raster.cpu import BOUNDS
from cags_common.splats import Splats
from cags_encoder.scenes import FrameSource, open_scene
from cags_gpu.device import choose
from cags_gpu.raster import GpuScene
from cags_gpu.timing import frame_counts
from cags_gpu.work import (
    DEVICES,
    STEPS,
    FrameCounts,
    compared_bytes,
    estimated_ms,
    operations,
    pass_bytes,
    read_back_bytes,
    visits,
)

LEAST_PSNR_DB = 100.0
LEAST_SHARE = 0.9999
"""Least share of a corrected frame's pixels within one level of 255 of the definition's, and of the CPU's."""

WORK_SIZE, WORK_SPLATS = (1600, 1200), 150_000
REFERENCE_SIZE = (400, 300)
STEP_RADII = 0.1
"""Distance between the reference camera and the client's, in radii of the focus."""

PICTURE_ERROR = 1e-4
"""Mean squared coding error declared for a picture: 40 dB."""

EXACT = RenderOptions(exactness=Exactness.EXACT)

Line = dict[str, Any]


def measure_backends(settings: RasterSettings, backends: Sequence[str]) -> Iterator[Line]:
    """One line per scene, size and backend; with ``gpu`` also corrections and work; then the summary.

    Raises :class:`~cags_common.errors.ConfigError` if a backend cannot run on this machine.
    """
    rasterisers = {name: create(name) for name in backends}
    lines: list[Line] = []
    for spec in settings.scene_list:
        source = open_scene(spec)
        splats = source.frame(0)
        scenes = {name: rasteriser.load(splats) for name, rasteriser in rasterisers.items()}
        for size in settings.size_list:
            for line in _case(settings, source, splats, size, scenes):
                lines.append(line | _adapter(line))
                yield lines[-1]
    if "gpu" in backends:
        for line in work_lines(_like_the_work(settings.scene_list)):
            lines.append(line | _adapter({"backend": "gpu"}))
            yield lines[-1]
    yield summary("raster", _checks(lines), backends=list(backends), repetitions=settings.repetitions)


def _like_the_work(specs: Sequence[str]) -> str:
    """The scene with a size near :data:`WORK_SPLATS`, within a factor of two; otherwise a generated one."""
    sizes = {spec: len(open_scene(spec).frame(0)) for spec in specs}
    best = min(sizes, key=lambda spec: abs(sizes[spec] - WORK_SPLATS))
    near = WORK_SPLATS / 2 <= sizes[best] <= 2 * WORK_SPLATS
    return best if near else f"procedural:size={WORK_SPLATS},frames=1"


def _adapter(line: Line) -> Line:
    named = {"adapter": str(choose()[0])} if line.get("backend") == "gpu" else {}
    return named | provenance()


def _case(
    settings: RasterSettings, source: FrameSource, splats: Splats, size: tuple[int, int], scenes: dict[str, RasterScene]
) -> Iterator[Line]:
    camera = view_of(source, *size)
    view: Line = {"scene": source.name, "splats": len(splats), "size": size_text(size)}
    right = create("oracle").load(splats).render(camera, EXACT)
    options = RenderOptions(threads=max(settings.thread_list))
    times = interleaved([_drawing(scene, camera, options) for scene in scenes.values()], settings)
    for (name, scene), taken in zip(scenes.items(), times, strict=True):
        errors = errors_against(scene.render(camera, EXACT), right)
        yield {"case": "backend", **view, "backend": name, "balanced_ms": round(statistics.median(taken), 2), **errors}
    gpu = scenes.get("gpu")
    if isinstance(gpu, GpuScene):
        for line in correction_lines(source, splats, camera, gpu):
            yield {"case": "correction", **view, "backend": "gpu", **line}


def _drawing(scene: RasterScene, camera: Camera, options: RenderOptions) -> Any:
    return lambda: scene.render(camera, options).rgb


def errors_against(ours: RenderedView, right: RenderedView) -> Line:
    """PSNR (peak 1), and errors relative to the brightest colour: 99th percentile and maximum over pixels."""
    error = np.abs(ours.rgb.astype(np.float64) - right.rgb)
    share = error.max(axis=2) / max(1.0, float(right.rgb.max()))
    return {
        "psnr_db": round(-10 * float(np.log10(max(np.mean(error**2), 1e-20))), 1),
        "usual_error": float(np.quantile(share, 0.99)),
        "worst_error": float(share.max()),
        "worst_alpha_error": float(np.abs(ours.alpha - right.alpha).max()),
    }


def correction_lines(source: FrameSource, splats: Splats, camera: Camera, scene: GpuScene) -> Iterator[Line]:
    """Accuracy of corrected frames from the device, for a difference and a picture from a camera to the side.

    Shares of pixels within a level of 255 of the definition's frame, and of the CPU's.
    """
    native = create("auto").load(splats)
    view = native.render(camera, EXACT)
    for kind, reference in _references(native, _aside(source, camera)).items():
        given = Correction(reference, camera.intrinsics)
        own = native.render(reference.camera, given.own_drawing(EXACT)).rgb if reference.picture else None
        right = correct(view, camera, reference, own)
        by_cpu = correction.create().correct(view, camera, reference, own)
        start = time.perf_counter()
        ours = scene.frame(camera, EXACT, given)
        taken = (time.perf_counter() - start) * 1e3
        if ours is None:
            raise RuntimeError("the device was lost during a frame; run the command again")
        yield {
            "kind": kind,
            "share_within_a_level": _share_within_a_level(ours.rgb, right.rgb),
            "of_the_cpus": _share_within_a_level(ours.rgb, by_cpu.rgb),
            "added_to": float((right.confidence > 0).mean()),
            "first_frame_ms": round(taken, 2),
        }


def _references(truth: RasterScene, reference_camera: Camera) -> dict[str, Reference]:
    """Test references: the difference to a client that lacks 30 % of the light, and a picture with 30 % more light."""
    seen = truth.render(reference_camera, EXACT).rgb
    lack = np.clip(seen, 0, 1) * np.float32(0.3)
    brighter = np.clip(seen * np.float32(1.3), 0, 1)
    return {
        "difference": Reference(compand(lack, 0.1).astype(np.float32), reference_camera),
        "picture": Reference(brighter, reference_camera, picture=True, error=PICTURE_ERROR),
    }


def _share_within_a_level(a: F32, b: F32) -> float:
    return float((np.abs(a.astype(np.float64) - b) <= 1 / 255).all(axis=2).mean())


def _aside(source: FrameSource, camera: Camera) -> Camera:
    """The server's camera: lower resolution, wider, and a step to the side."""
    focus, position = source.focus, np.asarray(camera.pose.position)
    aside = position + STEP_RADII * focus.radius * camera.pose.rotation_matrix[:, 0]
    eye = float(aside[0]), float(aside[1]), float(aside[2])
    width, height = (min(a, b) for a, b in zip(REFERENCE_SIZE, (camera.width_px, camera.height_px), strict=True))
    i = camera.intrinsics
    fov_x, fov_y = (2 * np.arctan(1.1 * side / 2 / f) for side, f in ((i.width_px, i.fx_px), (i.height_px, i.fy_px)))
    pose = Pose.looking_at(eye, focus.centre, source.up)
    return Camera(Intrinsics.of_fov(width, height, float(fov_x), float(fov_y)), pose, camera.near)


def counted(spec: str, size: tuple[int, int]) -> tuple[str, FrameCounts]:
    """A scene's name, and the counts of its view at this size, without blending it."""
    source = open_scene(spec)
    camera = view_of(source, *size)
    scene = create("gpu").load(source.frame(0))
    assert isinstance(scene, GpuScene)
    reference_camera = replace(camera, intrinsics=camera.intrinsics.resized(*REFERENCE_SIZE))
    counts = scene.on_device(
        lambda resident: frame_counts(resident, camera, RenderOptions(), reference_camera), lambda _: None
    )
    if counts is None:
        raise RuntimeError("the device was lost during a frame; run the command again")
    return source.name, counts


def work_lines(spec: str, size: tuple[int, int] = WORK_SIZE) -> Iterator[Line]:
    """Entries, visits, bytes per pass and estimates for 150,000 splats, before and after each improvement."""
    name, counts = counted(spec, size)
    scaled = counts.scaled(WORK_SPLATS)
    made_of = {"scene": name, "size": size_text(size), "counted_splats": counts.splats, "splats": WORK_SPLATS}
    for step, design in STEPS:
        moved = pass_bytes(scaled, design)
        yield {
            "case": "work",
            **made_of,
            "step": step,
            "visible": scaled.visible,
            "entries": scaled.entries if design.ellipse else scaled.box_entries,
            "pixels_x_splats": visits(scaled, design),
            "operations": operations(scaled, design),
            "bytes": moved,
            "bytes_total": sum(moved.values()),
            "estimated_ms": {device.name: round(estimated_ms(scaled, device, design), 2) for device in DEVICES},
        }
    for way, in_one_go in (("step by step", False), ("in one go", True)):
        down = {
            "a client's frame": read_back_bytes(scaled, in_one_go=in_one_go),
            "a server's reference": compared_bytes(scaled, in_one_go=in_one_go),
        }
        yield {"case": "read-back", **made_of, "way": way, "bytes": down}


def _checks(lines: list[Line]) -> list[Line]:
    checks = []
    bound = BOUNDS[Exactness.EXACT]
    for backend in dict.fromkeys(line["backend"] for line in lines if line["case"] == "backend"):
        own = [line for line in lines if line["case"] == "backend" and line["backend"] == backend]
        least = min(line["psnr_db"] for line in own)
        worst = max(max(line["worst_error"], line["worst_alpha_error"]) for line in own)
        name = f"PSNR of {backend} exact against the definition, worst view"
        checks.append(check(name, f">= {LEAST_PSNR_DB:.0f} dB", least, least >= LEAST_PSNR_DB))
        checks.append(check(f"worst pixel of {backend} exact", f"<= {bound.largest}", worst, worst <= bound.largest))
    for whose, field in (("the definition's", "share_within_a_level"), ("the CPU's", "of_the_cpus")):
        shares = [line[field] for line in lines if line["case"] == "correction"]
        if shares:
            name = f"corrected pixels within 1/255 of {whose}, worst view"
            checks.append(check(name, f">= {LEAST_SHARE}", min(shares), min(shares) >= LEAST_SHARE))
    work = [line for line in lines if line["case"] == "work"]
    for device in DEVICES if work else ():
        value, most = work[-1]["estimated_ms"][device.name], device.target_ms[1]
        name = f"estimate: frame of {WORK_SPLATS} splats at {size_text(WORK_SIZE)} on {device.name}"
        checks.append(check(name, f"<= {most:g} ms", value, value <= most))
    return checks
