"""The cases of ``cags-bench raster``: scenes, sizes, threads and levels; growth; the limit of the machine."""

from __future__ import annotations

import math
import resource
import statistics
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

import cags_kernels
from cags_bench.jsonl import check, provenance, summary
from cags_bench.raster.contenders import Contender, Frame, backend_contenders, prototype_contender
from cags_bench.raster.peers import peer_contenders
from cags_bench.raster.settings import RasterSettings
from cags_bench.raster.upkeep import upkeep_checks, upkeep_line
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.raster import Exactness, RenderedView, RenderOptions, create
from cags_common.splats import Splats
from cags_encoder.scenes import FrameSource, open_scene

FOV_X_RAD = 1.0
VIEW_RADII = 2.0
"""Distance of the camera from the focus, in radii of the focus."""

GROWTH = (50_000, 100_000, 200_000, 400_000, 800_000)

REFERENCE_SIZE = (400, 300)
"""Size of the frame that a server draws for each client."""

LEAST_TIMES_FASTER = 50.0
"""Required speed-up over any peer."""

MULTIPLY_ADDS_A_PAIR = 13.0
"""Multiplier operations to blend one splat at one pixel: 1.5 for s (shared by half the rows of a block), 1 for t, 2 for
the exponent, 3 for exp2, 1 for the weight, 4 for the sums of colour and depth, and 0.5 for the rest."""

Line = dict[str, Any]


def measure(settings: RasterSettings) -> Iterator[Line]:
    """Yield all lines of the benchmark."""
    ratios: list[float] = []
    peer_ratios: list[float] = []
    upkeep: list[Line] = []
    psnr: dict[str, list[float]] = {level: [] for level in Exactness}
    for spec in settings.scene_list:
        source = open_scene(spec)
        splats = source.frame(0)
        contenders = backend_contenders(splats)
        prototype = prototype_contender(splats, Path(settings.shared))
        contenders += [prototype] if prototype else []
        peers = peer_contenders(splats) if settings.peers else []
        for size in settings.size_list if settings.views else []:
            camera = view_of(source, *size)
            errors = errors_of(splats, camera) if settings.reference else {}
            for level, figures in errors.items():
                psnr[level].append(figures["psnr_db"])
            for threads in settings.thread_list:
                times = interleaved([c.frame(camera, threads) for c in contenders], settings)
                view: Line = {"scene": source.name, "splats": len(splats), "threads": threads, "size": size_text(size)}
                lines = list(_case_lines(view, contenders, times, errors))
                if prototype:
                    ratios.append(lines[0]["ratio_to_prototype"])  # of the first contender, "balanced"
                yield from lines
            times = interleaved([c.frame(camera, max(settings.thread_list)) for c in [contenders[0], *peers]], settings)
            for peer, taken in zip(peers, times[1:], strict=True):
                peer_ratios.append(_ratio(taken, times[0]))
                view = {"scene": source.name, "splats": len(splats), "size": size_text(size)}
                line = {"case": "peer", **view, "peer": peer.name, **_spread(taken), "balanced": _spread(times[0])}
                yield line | {"times_slower": peer_ratios[-1], **provenance()}
        if settings.upkeep:
            upkeep.append(upkeep_line(source.name, splats, view_of(source, *REFERENCE_SIZE), settings.repetitions))
            yield upkeep[-1]
    growth = list(_growth(settings)) if settings.growth else []
    yield from growth
    limit = _limit(settings)
    yield limit
    checks = _checks(ratios, psnr) + _growth_checks(growth) + _peer_checks(peer_ratios)
    checks += [judged for line in upkeep for judged in upkeep_checks(line)]
    figures = {"repetitions": settings.repetitions, "warm_up": settings.warm_up}
    yield summary("raster", checks, times_over_the_limit=limit["times_over_the_limit"], **figures)


def view_of(source: FrameSource, width: int, height: int) -> Camera:
    """A camera beside and slightly above the scene's focus, looking at it."""
    focus, up = source.focus, np.asarray(source.up, np.float64)
    side = np.cross(up, (0.31, 0.17, 0.93))
    direction = side / np.linalg.norm(side) + 0.35 * up
    eye = np.asarray(focus.centre) + VIEW_RADII * focus.radius * direction / np.linalg.norm(direction)
    fov_y = 2 * math.atan(math.tan(FOV_X_RAD / 2) * height / width)
    pose = Pose.looking_at((float(eye[0]), float(eye[1]), float(eye[2])), focus.centre, source.up)
    return Camera(Intrinsics.of_fov(width, height, FOV_X_RAD, fov_y), pose)


def interleaved(frames: list[Frame], settings: RasterSettings) -> list[list[float]]:
    """Milliseconds of each frame function. The functions take turns, so that all run under the same load."""
    times: list[list[float]] = [[] for _ in frames]
    for turn in range(settings.warm_up + settings.repetitions):
        for taken, frame in zip(times, frames, strict=True):
            start = time.perf_counter()
            frame()
            if turn >= settings.warm_up:
                taken.append((time.perf_counter() - start) * 1e3)
    return times


def size_text(size: tuple[int, int]) -> str:
    """WIDTHxHEIGHT, pixels."""
    return f"{size[0]}x{size[1]}"


def errors_of(splats: Splats, camera: Camera) -> dict[str, Line]:
    """PSNR, largest error and depth error of each level against the float64 reference."""
    right = create("oracle").load(splats).render(camera, RenderOptions())
    scene = create("cpu").load(splats)
    return {level: _errors(scene.render(camera, RenderOptions(exactness=level)), right) for level in Exactness}


def _errors(ours: RenderedView, right: RenderedView) -> Line:
    error = ours.rgb.astype(np.float64) - right.rgb
    assert ours.depth is not None
    assert right.depth is not None
    both = np.isfinite(ours.depth) & np.isfinite(right.depth)
    depth = np.abs(ours.depth[both] / right.depth[both] - 1.0)
    return {
        "psnr_db": round(-10 * math.log10(max(float(np.mean(error**2)), 1e-20)), 1),
        "max_error": float(np.abs(error).max()),
        "depth_error_rms": float(np.sqrt(np.mean(depth**2))) if depth.size else 0.0,
    }


def _case_lines(
    view: Line, contenders: list[Contender], times: list[list[float]], errors: dict[str, Line]
) -> Iterator[Line]:
    prototype = next((taken for c, taken in zip(contenders, times, strict=True) if c.name == "prototype"), None)
    for contender, taken in zip(contenders, times, strict=True):
        line: Line = {"case": "view", **view, "level": contender.name, **_spread(taken)}
        if prototype:
            line["ratio_to_prototype"] = _ratio(taken, prototype)
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        yield line | errors.get(contender.name, {}) | {"peak_memory_mib": round(memory)} | provenance()


def _ratio(taken: list[float], other: list[float]) -> float:
    return round(statistics.median(a / b for a, b in zip(taken, other, strict=True)), 3)


def _spread(taken: list[float]) -> Line:
    low, high = np.quantile(taken, (0.25, 0.75))
    return {"ms": round(statistics.median(taken), 2), "ms_quartiles": [round(float(low), 2), round(float(high), 2)]}


def _growth(settings: RasterSettings) -> Iterator[Line]:
    threads = max(settings.thread_list)
    for count in GROWTH:
        source = open_scene(f"procedural:size={count},frames=1")
        splats = source.frame(0)
        contenders = backend_contenders(splats)[:1]
        prototype = prototype_contender(splats, Path(settings.shared))
        contenders += [prototype] if prototype else []
        for size in settings.size_list[:1] + settings.size_list[-1:]:
            times = interleaved([c.frame(view_of(source, *size), threads) for c in contenders], settings)
            line: Line = {"case": "growth", "splats": len(splats), "threads": threads, "size": f"{size[0]}x{size[1]}"}
            line |= _spread(times[0]) | {
                "us_a_thousand_splats": round(statistics.median(times[0]) * 1e6 / len(splats), 1)
            }
            if prototype:
                line["ratio_to_prototype"] = round(statistics.median(np.divide(times[0], times[1]).tolist()), 3)
            yield line | provenance()


def _limit(settings: RasterSettings) -> Line:
    """Pixel-splat pairs per second on one thread, and the limit set by the multipliers."""
    from cags_kernels.raster import NativeScene, RasterCamera, RasterOptions

    source = open_scene(settings.scene_list[0])
    width, height = settings.size_list[-1]
    camera = view_of(source, width, height)
    splats = source.frame(0)
    scene = NativeScene(tuple(array for _, array in splats.arrays()))
    i = camera.intrinsics
    pinhole = (i.fx_px, i.fy_px, i.cx_px, i.cy_px, camera.near, width, height)
    native = RasterCamera(camera.world_to_camera[0], np.asarray(camera.pose.position), *pinhole)
    options = RasterOptions(0.3, 0.0, 0.05, exactness=1, depth=1, max_sh_degree=3, threads=1)
    pairs, peak = [], []
    for _ in range(settings.warm_up + settings.repetitions):
        start = time.process_time()
        image = scene.render(native, options)
        pairs.append(16 * image.statistics.block_visits / (time.process_time() - start))
        start = time.process_time()
        peak.append(cags_kernels.multiply_adds(2_000_000) / (time.process_time() - start))
    reached, possible = max(pairs), max(peak) / MULTIPLY_ADDS_A_PAIR
    return {
        "case": "limit",
        "scene": source.name,
        "size": size_text((width, height)),
        "instruction_set": cags_kernels.instruction_set(),
        "pairs_a_second": round(reached),
        "multiply_adds_a_second": round(max(peak)),
        "pairs_possible": round(possible),
        "times_over_the_limit": round(possible / reached, 2),
        **provenance(),
    }


def _checks(ratios: list[float], psnr: dict[str, list[float]]) -> list[Line]:
    checks = []
    if ratios:
        median = round(statistics.median(ratios), 3)
        checks.append(check("balanced / prototype, median over the cases", "<= 1.0", median, median <= 1.0))
    for level, least in ((Exactness.BALANCED, 60.0), (Exactness.EXACT, 100.0)):
        if psnr[level]:
            worst = min(psnr[level])
            checks.append(
                check(f"PSNR of {level} against the reference, worst view", f">= {least:.0f} dB", worst, worst >= least)
            )
    return checks


def _growth_checks(growth: list[Line]) -> list[Line]:
    """Check for each size that time grows at most in proportion to the number of splats."""
    checks = []
    for size in dict.fromkeys(line["size"] for line in growth):
        lines = [line for line in growth if line["size"] == size]
        few, many = lines[0], lines[-1]
        times, splats = round(many["ms"] / few["ms"], 2), round(many["splats"] / few["splats"], 2)
        name = f"time at {size}, {many['splats']} / {few['splats']} splats"
        checks.append(check(name, f"<= {splats}", times, times <= splats))
    return checks


def _peer_checks(ratios: list[float]) -> list[Line]:
    name, target = "times faster than the fastest peer, worst view", f">= {LEAST_TIMES_FASTER:.0f}"
    if not ratios:
        return [check(name, target, "no peer is installed (pip install open3d)", False)]
    return [check(name, target, min(ratios), min(ratios) >= LEAST_TIMES_FASTER)]
