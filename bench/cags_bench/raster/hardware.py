"""``cags-bench raster --table``: the paper's client table, references per second and growth, on this machine's GPU."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from cags_bench.jsonl import check, provenance, summary
from cags_bench.raster.cases import REFERENCE_SIZE, size_text, view_of
from cags_bench.raster.many_clients import KNEE, SCENE, WAKE_S, client_scene, reference_checks, reference_lines
from cags_bench.raster.settings import RasterSettings
from cags_common.correction import Reference
from cags_common.correction.compander import ZERO
from cags_common.raster import RenderOptions, create
from cags_common.splats import Splats
from cags_encoder.scenes import FrameSource, open_scene
from cags_gpu.correct import shown
from cags_gpu.device import choose
from cags_gpu.raster import GpuScene
from cags_gpu.timing import frame_times_ms

FRAME_MS = 3.0
"""Target for a whole client frame."""

Line = dict[str, Any]


def measure_table(settings: RasterSettings) -> Iterator[Line]:
    """Client table at the largest size, then clients, then growth. Raises :class:`ConfigError` without an adapter."""
    adapter, _ = choose()
    rasteriser, lines = create("gpu"), []
    source, splats = client_scene(settings)
    scene = rasteriser.load(splats)
    assert isinstance(scene, GpuScene)
    parts: list[Iterator[Line]] = [
        client_lines(settings, source, splats, scene),
        reference_lines(settings, scene),
        *(growth_lines(settings, count) for count in settings.growth_list),
    ]
    for part in parts:
        for line in part:
            lines.append(line | {"adapter": str(adapter), "software": adapter.software, **provenance()})
            yield lines[-1]
    yield summary("raster", _checks(lines), adapter=str(adapter), repetitions=settings.repetitions)


def client_lines(settings: RasterSettings, source: FrameSource, splats: Splats, scene: GpuScene) -> Iterator[Line]:
    """Drawing, correction, and the whole frame including the read-back of the displayed picture."""
    size = settings.size_list[-1]
    camera, options = view_of(source, *size), RenderOptions()
    reference_camera = replace(camera, intrinsics=camera.intrinsics.resized(*REFERENCE_SIZE))
    grey = Reference(
        np.full((reference_camera.height_px, reference_camera.width_px, 3), ZERO, np.float32),
        reference_camera,
        knee=KNEE,
    )
    stages: dict[str, Callable[[], object]] = {
        "drawn and shown": lambda: shown(scene, camera, options, None),
        "whole frame": lambda: shown(scene, camera, options, grey),
    }
    spent = _interleaved(stages, settings)
    spent["correction"] = [b - a for a, b in zip(spent["drawn and shown"], spent["whole frame"], strict=True)]
    made_of = {"case": "client", "scene": source.name, "splats": len(splats), "size": size_text(size)}
    for stage, taken in spent.items():
        yield {**made_of, "stage": stage, "ms": round(statistics.median(taken), 3), "least_ms": round(min(taken), 3)}
    passes = scene.on_device(lambda resident: frame_times_ms(resident, camera, options), lambda _: {})
    device = {label: round(ms, 4) for label, ms in passes.items()}
    yield {**made_of, "stage": "drawing on the device's clock", "ms": round(sum(device.values()), 3), "passes": device}


def growth_lines(settings: RasterSettings, count: int) -> Iterator[Line]:
    """Time of a frame with ``count`` splats at the smallest and the largest size."""
    source = open_scene(SCENE.format(splats=count))
    scene = create("gpu").load(source.frame(0))
    assert isinstance(scene, GpuScene)
    for size in dict.fromkeys((settings.size_list[0], settings.size_list[-1])):
        draw = partial(shown, scene, view_of(source, *size), RenderOptions(), None)
        ms = round(statistics.median(_interleaved({"frame": draw}, settings)["frame"]), 3)
        yield {"case": "growth", "splats": count, "size": size_text(size), "ms": ms}


def _interleaved(stages: dict[str, Callable[[], object]], settings: RasterSettings) -> dict[str, list[float]]:
    spent: dict[str, list[float]] = {name: [] for name in stages}
    for stage in stages.values():
        stage()
    awake = time.perf_counter() + WAKE_S
    while time.perf_counter() < awake:
        for stage in stages.values():
            stage()
    for turn in range(settings.warm_up + settings.repetitions):
        for name, stage in stages.items():
            start = time.perf_counter()
            stage()
            if turn >= settings.warm_up:
                spent[name].append((time.perf_counter() - start) * 1e3)
    return spent


def _checks(lines: list[Line]) -> list[Line]:
    frames = [x for x in lines if x["case"] == "client" and x["stage"] == "whole frame" and x["size"] == "1600x1200"]
    checks = [
        check("whole client frame at 1600x1200", f"<= {FRAME_MS:g} ms", x["ms"], x["ms"] <= FRAME_MS) for x in frames
    ]
    return checks + reference_checks(lines)
