"""The measurement behind ``cags-bench align``."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from statistics import median

import numpy as np

from cags_bench.align.serving import serving_line
from cags_bench.align.settings import AlignBenchSettings
from cags_bench.align.views import View, fresh, view_of
from cags_bench.bundles import cached_bundle
from cags_bench.jsonl import JsonObject, check, provenance, summary
from cags_common import correction, raster
from cags_common.bundle import BundleReader
from cags_common.correction import Corrector, Reference
from cags_common.geometry import F32
from cags_common.metrics import covered_mask, psnr
from cags_common.raster.base import DepthKind, RenderOptions
from cags_encoder import EncodeSettings

WARM_UP = 2

RASTER, DIFFERENCE, PICTURE, CORRECT = "raster", "raster, difference", "raster, picture", "correct"
GPU_RASTER, GPU_DIFFERENCE = "gpu raster", "gpu raster, difference"

CORRECT_MS = {"1600x1200": 6.0, "800x600": 3.0}
"""Time limit to correct a frame with a new difference, milliseconds."""

FRAME_MS = {"800x600": 20.0}
"""Time limit for the whole frame with a new difference, milliseconds."""

Works = Mapping[str, Callable[[], F32]]


def measure(settings: AlignBenchSettings) -> Iterator[JsonObject]:
    """One line per size and method, one per number of clients, then the summary with its checks."""
    if settings.device == "gpu":
        raster.create("gpu")  # refuse a missing device before encoding
    bundle = cached_bundle(settings.scene, settings.cache, EncodeSettings(frames=settings.frames))
    lines: list[JsonObject] = []
    with BundleReader.open(str(bundle)) as reader:
        for size in settings.size_list:
            for line in frame_lines(view_of(reader, settings, size), settings):
                lines.append(line)
                yield line
    for clients in settings.client_list:
        lines.append(serving_line(bundle, clients, settings))
        yield lines[-1]
    yield summary("align", checks_of(lines), scene=settings.scene)


def frame_lines(view: View, settings: AlignBenchSettings) -> list[JsonObject]:
    """All methods at one size, interleaved: wall-clock and processor milliseconds, and quality."""
    works = _works(view, settings)
    if settings.device == "gpu":
        works = {**works, **_gpu_works(view, settings)}
    times = interleaved(works, settings.repetitions)
    truth = view.truth.render(view.camera, RenderOptions(threads=settings.threads))
    covered = covered_mask(truth.alpha)
    common = {
        "benchmark": "align",
        "part": "frame",
        "size": f"{view.camera.width_px}x{view.camera.height_px}",
        "splats": len(view.splats),
        "threads": settings.threads,
        "warm_up": WARM_UP,
        "repetitions": settings.repetitions,
        "seed": settings.seed,
    }
    lines = []
    for name, taken in times.items():
        quality = psnr(works[name]().clip(0, 1), truth.rgb.clip(0, 1), covered)
        lines.append({**common, "work": name, **taken, "psnr_covered_db": quality, **provenance()})
    return lines


def _works(view: View, settings: AlignBenchSettings) -> dict[str, Callable[[], F32]]:
    draw = RenderOptions(threads=settings.threads, displayed=True)
    flat = replace(draw, depth=DepthKind.NONE)
    drawn = view.held.render(view.camera, draw)
    one, two, three = (correction.create("auto", settings.threads) for _ in range(3))

    def corrected(corrector: Corrector, reference: Reference, own: F32 | None = None) -> F32:
        return corrector.correct(view.held.render(view.camera, draw), view.camera, fresh(reference), own).rgb

    return {
        RASTER: lambda: view.held.render(view.camera, flat).rgb,
        DIFFERENCE: lambda: corrected(one, view.difference),
        PICTURE: lambda: corrected(two, view.picture, view.own()),
        CORRECT: lambda: three.correct(drawn, view.camera, fresh(view.difference)).rgb,
    }


def _gpu_works(view: View, settings: AlignBenchSettings) -> dict[str, Callable[[], F32]]:
    """Frames made on the device, as bytes for display."""
    from cags_gpu.correct import shown
    from cags_gpu.raster import GpuScene

    scene = view.held
    assert isinstance(scene, GpuScene), "device gpu loads scenes there"
    draw = RenderOptions(threads=settings.threads, displayed=True)

    def frame(reference: Reference | None) -> F32:
        return np.asarray(shown(scene, view.camera, draw, reference)[..., :3] / np.float32(255), np.float32)

    return {GPU_RASTER: lambda: frame(None), GPU_DIFFERENCE: lambda: frame(fresh(view.difference))}


def interleaved(works: Works, repetitions: int) -> dict[str, JsonObject]:
    """Median and spread of wall-clock and processor time of each piece of work, in milliseconds."""
    walls: dict[str, list[float]] = {name: [] for name in works}
    processor: dict[str, list[float]] = {name: [] for name in works}
    for repetition in range(WARM_UP + repetitions):
        for name, work in works.items():
            began, began_cpu = time.perf_counter(), time.process_time()
            work()
            wall, cpu = time.perf_counter() - began, time.process_time() - began_cpu
            if repetition >= WARM_UP:
                walls[name].append(wall * 1e3)
                processor[name].append(cpu * 1e3)
    return {
        name: {
            "ms": median(walls[name]),
            "least_ms": min(walls[name]),
            "spread_ms": max(walls[name]) - min(walls[name]),
            "processor_ms": median(processor[name]),
            "processor_spread_ms": max(processor[name]) - min(processor[name]),
        }
        for name in works
    }


def checks_of(lines: Sequence[JsonObject]) -> list[JsonObject]:
    """Targets for the wall-clock time of the client's frame, for the sizes that were measured."""
    by = {(line["size"], line["work"]): line for line in lines if line["part"] == "frame"}
    wanted = [(f"correct at {size}", by.get((size, CORRECT)), limit) for size, limit in CORRECT_MS.items()]
    wanted += [(f"whole frame at {size}", by.get((size, DIFFERENCE)), limit) for size, limit in FRAME_MS.items()]
    return [
        check(name, f"<= {limit:g} ms", round(line["ms"], 2), line["ms"] <= limit)
        for name, line, limit in wanted
        if line is not None
    ]
