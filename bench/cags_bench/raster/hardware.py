"""``cags-bench raster --table``: the paper's client table, references per second and growth, on this machine's GPU."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from cags_bench.jsonl import check, provenance, summary
from cags_bench.raster.cases import REFERENCE_SIZE, size_text, view_of
from cags_bench.raster.settings import RasterSettings
from cags_common.correction import Look, Reference
from cags_common.correction.compander import ZERO
from cags_common.geometry import Pose
from cags_common.raster import Footprint, RenderOptions, create
from cags_common.splats import Splats
from cags_encoder.scenes import FrameSource, open_scene
from cags_gpu.correct import shown
from cags_gpu.device import choose
from cags_gpu.raster import GpuScene
from cags_gpu.timing import frame_times_ms

SCENE = "procedural:size={splats},frames=1"
FRAME_SPLATS = 150_000
FRAME_MS = 3.0
"""Target for a whole client frame."""

CLIENTS_RATE = 64, 30
"""Target: number of clients, and references per second for each."""

WAKE_S = 2.0
"""Frames before those that are timed, once all pipelines are made: a device at rest runs at a fifth of its clock."""

KNEE = 0.1

MOVING_SHARE = 1 / 8
"""Splats that move in every frame of the mirrors that do."""

Line = dict[str, Any]


def measure_table(settings: RasterSettings) -> Iterator[Line]:
    """Client table at the largest size, then clients, then growth. Raises :class:`ConfigError` without an adapter."""
    adapter, _ = choose()
    rasteriser, lines = create("gpu"), []
    source = open_scene(SCENE.format(splats=min(FRAME_SPLATS, max(settings.growth_list))))
    splats = source.frame(0)
    scene = rasteriser.load(splats)
    assert isinstance(scene, GpuScene)
    parts: list[Iterator[Line]] = [
        client_lines(settings, source, splats, scene),
        *(
            reference_lines(settings, source, splats, scene, clients, moving=moving)
            for clients in settings.client_list
            for moving in (False, True)
        ),
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


def reference_lines(
    settings: RasterSettings, source: FrameSource, splats: Splats, truth: GpuScene, clients: int, *, moving: bool
) -> Iterator[Line]:
    """References per second of a server that renders for all clients at once, each at a place of its own: truth and
    mirror are drawn, subtracted and companded, and both pictures come as floats. With ``moving``, splats of the
    mirrors move before each of them, as those of clients do.
    """
    camera = view_of(source, *settings.size_list[-1])
    reference_camera = replace(camera, intrinsics=camera.intrinsics.resized(*REFERENCE_SIZE))
    footprint = Footprint.of(camera.intrinsics, reference_camera.intrinsics)
    options = RenderOptions(footprint=footprint, contribution=True)
    looks = Look.LACK, Look.COMPANDED

    side = reference_camera.pose.rotation_matrix[:, 0]
    places = np.asarray(reference_camera.pose.position) + source.focus.radius * np.outer(
        np.linspace(0, 0.5, clients), side
    )
    poses = [replace(reference_camera.pose, position=(x, y, z)) for x, y, z in places.tolist()]

    def compare(mirror: _Mirror, pose: Pose) -> None:
        if moving:
            mirror.move()
        views = truth.compared(mirror.scene, reference_camera.at(pose), options, knee=KNEE, looks=looks)
        if views is None:
            raise RuntimeError("the device was lost or cannot hold the scenes; draw fewer splats and run it again")
        _ = views.lack, views.companded(KNEE)

    def in_turn(mirror: _Mirror, pose: Pose) -> None:
        for _ in range(settings.repetitions):  # a client has one under way
            compare(mirror, pose)

    mirrors = [_Mirror(splats, seed) for seed in range(clients)]
    with ThreadPoolExecutor(clients) as pool:
        list(pool.map(compare, mirrors, poses))  # uploads, pipelines, room for entries
        awake = time.perf_counter() + WAKE_S
        while time.perf_counter() < awake:
            list(pool.map(compare, mirrors, poses))
        start = time.perf_counter()
        list(pool.map(in_turn, mirrors, poses))
        rate = settings.repetitions * clients / (time.perf_counter() - start)
    size = size_text((reference_camera.width_px, reference_camera.height_px))
    yield {"case": "references", "clients": clients, "moving": moving, "size": size, "a_second": round(rate, 1)}


class _Mirror:
    """A client's copy with different base colours, so that there is a difference to send."""

    def __init__(self, splats: Splats, seed: int) -> None:
        rng = np.random.default_rng(seed)
        noise = rng.normal(0.0, 0.1, splats.sh0.shape).astype(np.float32)
        held = replace(splats, sh0=splats.sh0 + noise)
        made = create("gpu").load(held)
        assert isinstance(made, GpuScene)
        self.scene = made
        self._rows = np.sort(rng.choice(len(splats), round(MOVING_SHARE * len(splats)), replace=False))
        away = held.means.copy()
        away[self._rows] += np.exp(held.log_scales[self._rows].min(axis=1, keepdims=True))
        self._next, self._last = replace(held, means=away), held

    def move(self) -> None:
        """Show the other of two places of some splats."""
        self.scene.move(self._rows, self._next)
        self._next, self._last = self._last, self._next


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
    clients, rate = CLIENTS_RATE
    many = [x["a_second"] for x in lines if x["case"] == "references" and x["clients"] == clients and not x["moving"]]
    return checks + [
        check(f"references a second for {clients} clients", f">= {clients * rate}", each, each >= clients * rate)
        for each in many
    ]
