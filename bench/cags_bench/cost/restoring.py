"""Stages that put colours right: alignment, erosion, restoration, and their useful combinations with drawing."""

from __future__ import annotations

from itertools import product

import numpy as np

from cags_bench.cost.engine import Outcome, Point, Stage
from cags_bench.cost.moments import Moment, Workbench
from cags_bench.seeing import available_restorers, see
from cags_client import align, restore
from cags_client.align import Aligned, AlignSettings
from cags_client.settings import ClientSettings
from cags_common.geometry import F32
from cags_common.metrics import psnr
from cags_common.raster.base import Exactness, RenderOptions

EROSIONS = (0, 2, 8, 16)


def restoring_stages(bench: Workbench) -> list[Stage]:
    """Erosion iterations, restoration tier, and the client's whole frame over combinations of settings."""
    return [_erosion(bench), _restoration(bench), _whole_frame(bench)]


def _erosion(bench: Workbench) -> Stage:
    def point(iterations: int) -> Point:
        aligner = align.create("auto", AlignSettings(erosion_iterations=iterations))

        def run() -> list[Aligned]:
            return [m.seen.aligned(m.reference, aligner, colours=True) for m in bench.moments]

        def judge(found: list[Aligned]) -> Outcome:
            masks = [a.occluded | (a.confidence > 0) for a in found]
            scores = [psnr(a.rgb, m.truth, k) for a, m, k in zip(found, bench.moments, masks, strict=True)]
            return {"aligned_psnr_db": float(np.mean(scores)), "pictures": len(found)}

        return Point(str(iterations), run, judge, default=iterations == AlignSettings().erosion_iterations)

    return Stage("alignment", "erosion iterations", "client", "aligned_psnr_db", tuple(map(point, EROSIONS)))


def _restoration(bench: Workbench) -> Stage:
    inputs = [m.seen.inputs(m.reference, m.seen.aligned(m.reference)) for m in bench.moments]

    def judge(found: list[F32]) -> Outcome:
        scores = [psnr(f, m.truth) for f, m in zip(found, bench.moments, strict=True)]
        return {"restored_psnr_db": float(np.mean(scores)), "pictures": len(found)}

    def point(name: str) -> Point:
        restorer = restore.create(name)
        return Point(
            name, lambda: [restorer.restore(one) for one in inputs], judge, default=name == ClientSettings().restore
        )

    return Stage(
        "restoration", "tier", "client", "restored_psnr_db", tuple(map(point, available_restorers())), repetitions=3
    )


def _whole_frame(bench: Workbench) -> Stage:
    """Draw, align and restore: every combination of exactness, erosion and tier, judged by the picture shown."""
    tiers = [name for name in ("none", "affine", "lite") if name in available_restorers()]
    points = []
    for exactness, iterations, tier in product(Exactness, (0, 8), tiers):
        if tier == "none" and iterations:
            continue  # nothing reads the aligned picture
        points.append(_combination(bench.moment, exactness, iterations, tier))
    return Stage(
        "client frame", "exactness / erosion / tier", "client", "restored_psnr_db", tuple(points), repetitions=3
    )


def _combination(moment: Moment, exactness: Exactness, iterations: int, tier: str) -> Point:
    aligner = align.create("auto", AlignSettings(erosion_iterations=iterations))
    restorer = restore.create(tier)

    def run() -> F32:
        seen = see(moment.seen.scene, moment.camera, RenderOptions(exactness=exactness))
        if tier == "none":
            return seen.distorted
        return restorer.restore(seen.inputs(moment.reference, seen.aligned(moment.reference, aligner)))

    usual = ClientSettings()
    ours = usual.exactness, AlignSettings().erosion_iterations if usual.erosion else 0, usual.restore
    return Point(
        f"{exactness.value} / {iterations} / {tier}",
        run,
        lambda rgb: {"restored_psnr_db": psnr(rgb, moment.truth)},
        default=(exactness.value, iterations, tier) == ours,
    )
