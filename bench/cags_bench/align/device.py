"""The paper's client table on one device: what rendering, PRPA and restoration of a frame take.

Each stage gives its result to the host, so that a device's transfers and the wait for them count.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from cags_bench.align.command import AlignBenchSettings
from cags_bench.jsonl import JsonObject, check, provenance, summary
from cags_bench.restore.cases import Case, Cases
from cags_client import align
from cags_client.align import AlignSettings
from cags_client.restore import RestoreInput, Restorer, networks
from cags_common import raster
from cags_common.geometry import F32
from cags_common.raster.base import RenderOptions

BACKENDS = {"cpu": "cpu", "gpu": "gpu"}
"""Rasterisers by device; alignment and networks run on the CPU. `cags-bench raster` has a GPU's whole frame."""

RESTORERS = ("srresnet", "lite")

PAPER_MS = {"render": 9.32, "PRPA": 2.11, "srresnet": 6.5}
"""The paper's table of the client at 1600x1200, on an RTX 3080."""

JUDGED = "1600x1200"


def client_table(settings: AlignBenchSettings) -> Iterator[JsonObject]:
    """One line a picture size and stage, then a summary against the paper's figures.

    Raises :class:`~cags_common.errors.ConfigError` where the device is not there.
    """
    raster.create(BACKENDS[settings.device])  # refuse a device that is not there before a scene is encoded
    cases, where, lines = Cases(settings), device_name(settings.device), []
    for size in settings.size_list:
        case = cases.first(size, settings.error_list[0])
        for stage, spent_ms in timed(_stages(case, settings), settings.repetitions).items():
            lines.append(
                {
                    "stage": stage,
                    "size": case.labels["size"],
                    "splats": len(case.splats),
                    "device": where,
                    "ms": statistics.median(spent_ms),
                    "least_ms": min(spent_ms),
                    "repetitions": settings.repetitions,
                    **provenance(),
                }
            )
            yield lines[-1]
    judged = {x["stage"]: x["ms"] for x in lines if x["size"] == JUDGED}
    limits = [("render", PAPER_MS["render"])] if settings.device == "gpu" else []
    checks = [
        check(f"{stage} at {JUDGED} on {where}", f"<= {limit:g} ms (paper)", judged[stage], judged[stage] <= limit)
        for stage, limit in limits
        if stage in judged
    ]
    yield summary("align", checks, device=where)


def device_name(device: str) -> str:
    """What the table's figures were taken on."""
    if device == "cpu":
        return str(provenance()["machine"])
    from cags_gpu.device import choose

    return str(choose()[0])


def _stages(case: Case, settings: AlignBenchSettings) -> dict[str, Callable[[], object]]:
    scene = raster.create(BACKENDS[settings.device]).load(case.splats)
    aligner = align.create("auto", AlignSettings(threads=settings.threads))
    depth, draw = case.distorted.depth, RenderOptions(threads=settings.threads)
    assert depth is not None
    aligned = aligner.align(case.reference, depth, case.camera, colours=True)
    distorted = np.clip(case.distorted.rgb, 0.0, 1.0)
    inputs = RestoreInput(distorted, case.distorted.alpha, aligned, case.reference, case.own())
    restorers = {name: networks.create(name, settings.threads) for name in RESTORERS}
    return {
        "render": lambda: scene.render(case.camera, draw),
        "PRPA": lambda: aligner.align(case.reference, depth, case.camera, colours=True),
        **{name: partial(_restored, restorer, inputs) for name, restorer in restorers.items()},
    }


def _restored(restorer: Restorer, inputs: RestoreInput) -> F32:
    return restorer.restore(inputs.afresh())


def timed(stages: dict[str, Callable[[], object]], repetitions: int) -> dict[str, list[float]]:
    """Milliseconds of each stage, interleaved, after one turn to warm up (which counts where it is the only one)."""
    spent: dict[str, list[float]] = {name: [] for name in stages}
    for turn in range(repetitions + 1):
        for name, stage in stages.items():
            start = time.perf_counter()
            stage()
            if turn or not repetitions:
                spent[name].append((time.perf_counter() - start) * 1e3)
    return spent
