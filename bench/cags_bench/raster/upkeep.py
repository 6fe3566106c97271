"""Costs of a scene apart from its frames: loading, partial updates, zero harmonics, contributions."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from cags_bench.jsonl import check, provenance
from cags_common.geometry import Camera
from cags_common.raster import DepthKind, RenderOptions, create
from cags_common.splats import SH_REST_OF_DEGREE, Splats

UPDATED = 4_000
FRAME_MS = 33.0
"""Time that a server has for one client's reference frame."""

Line = dict[str, Any]


def upkeep_line(name: str, splats: Splats, camera: Camera, repetitions: int) -> Line:
    """Median times of interleaved repetitions, ms; renders use one thread. ``camera`` is a reference frame's."""
    rows = np.sort(np.random.default_rng(0).choice(len(splats), min(UPDATED, len(splats)), replace=False))
    scene = create("cpu").load(splats)
    flat = replace(splats, sh_rest=np.zeros((len(splats), 0, 3), np.float32))
    zeros = replace(splats, sh_rest=np.zeros((len(splats), SH_REST_OF_DEGREE[3], 3), np.float32))
    full = replace(zeros, sh_rest=np.full_like(zeros.sh_rest, 0.01))
    loaded = {label: create("cpu").load(s) for label, s in (("flat", flat), ("zeros", zeros), ("full", full))}
    options = RenderOptions(threads=1, depth=DepthKind.NONE)
    actions: dict[str, Callable[[], object]] = {
        "load": lambda: create("cpu").load(splats),
        "update": lambda: scene.update(rows, splats),
        "move": lambda: scene.move(rows, splats, 2),
        "contribution": lambda: scene.render(camera, replace(options, contribution=True)),
        "contribution_2_threads": lambda: scene.render(camera, replace(options, contribution=True, threads=2)),
        "no_harmonics": lambda: loaded["flat"].render(camera, options),
        "harmonics_of_zeros": lambda: loaded["zeros"].render(camera, options),
        "harmonics_of_degree_3": lambda: loaded["full"].render(camera, options),
    }
    times: dict[str, list[float]] = {label: [] for label in actions}
    for turn in range(repetitions + 1):
        for label, action in actions.items():
            start = time.perf_counter()
            action()
            if turn:
                times[label].append((time.perf_counter() - start) * 1e3)
    figures = {f"{label}_ms": round(statistics.median(taken), 2) for label, taken in times.items()}
    return {"case": "upkeep", "scene": name, "splats": len(splats), "updated": len(rows), **figures, **provenance()}


def upkeep_checks(line: Line) -> list[Line]:
    """Checks of partial updates, zero harmonics, and a server's frame."""
    share = round(line["update_ms"] / line["load_ms"], 3)
    most = 3 * line["updated"] / line["splats"]
    zeros = round(line["harmonics_of_zeros_ms"] / line["no_harmonics_ms"], 3)
    frame = line["contribution_2_threads_ms"]
    return [
        check("update of 4,000 splats / load of all", f"<= 3 x their share, {most:.3f}", share, share <= most),
        check("frame with harmonics of zeros / without any", "<= 1.05", zeros, zeros <= 1.05),
        check("reference frame with contributions, 2 threads", f"<= {FRAME_MS:.0f} ms", frame, frame <= FRAME_MS),
    ]
