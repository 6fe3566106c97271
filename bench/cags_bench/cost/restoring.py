"""Stages that put colours right: alignment, erosion, restoration, and their useful combinations with drawing."""

from __future__ import annotations

from itertools import product

import numpy as np

from cags_bench.cost.engine import Outcome, Point, Stage
from cags_bench.cost.moments import Moment, Workbench
from cags_client import align, restore
from cags_client.align import Aligned, AlignSettings, ReferencePicture
from cags_client.restore import RestoreInput
from cags_common import raster
from cags_common.geometry import F32
from cags_common.metrics import psnr
from cags_common.raster.base import Exactness, RasterScene, RenderOptions
from cags_common.splats import Splats

EROSIONS = (0, 2, 8, 16)


def restoring_stages(bench: Workbench) -> list[Stage]:
    """Erosion iterations, restoration tier, and the client's whole frame over combinations of settings."""
    return [_erosion(bench), _restoration(bench), _whole_frame(bench)]


def _reference(moment: Moment) -> ReferencePicture:
    assert moment.presented.reference is not None
    return moment.presented.reference


def _erosion(bench: Workbench) -> Stage:
    def point(iterations: int) -> Point:
        aligner = align.create("auto", AlignSettings(erosion_iterations=iterations))

        def run() -> list[Aligned]:
            return [aligner.align(_reference(m), m.presented.depth, m.camera) for m in bench.moments]

        def judge(found: list[Aligned]) -> Outcome:
            masks = [a.occluded | (a.confidence > 0) for a in found]
            scores = [psnr(a.rgb, m.truth, k) for a, m, k in zip(found, bench.moments, masks, strict=True)]
            return {"aligned_psnr_db": float(np.mean(scores)), "pictures": len(found)}

        return Point(str(iterations), run, judge, default=iterations == AlignSettings().erosion_iterations)

    return Stage("alignment", "erosion iterations", "client", "aligned_psnr_db", tuple(map(point, EROSIONS)))


def _restoration(bench: Workbench) -> Stage:
    aligner = align.create("auto")
    inputs = []
    for m in bench.moments:
        aligned = aligner.align(_reference(m), m.presented.depth, m.camera)
        inputs.append(RestoreInput(m.presented.distorted, m.presented.alpha, aligned, _reference(m)))

    def judge(found: list[F32]) -> Outcome:
        scores = [psnr(f, m.truth) for f, m in zip(found, bench.moments, strict=True)]
        return {"restored_psnr_db": float(np.mean(scores)), "pictures": len(found)}

    def point(name: str) -> Point:
        restorer = restore.create(name)
        return Point(name, lambda: [restorer.restore(one) for one in inputs], judge, default=name == "affine")

    return Stage(
        "restoration", "tier", "client", "restored_psnr_db", tuple(map(point, restore.RESTORERS)), repetitions=3
    )


def decoded_splats(bench: Workbench, lod: int) -> Splats:
    """What a client holds of the middle moment's frame when everything has come up to ``lod``."""
    from cags_common.bundle import BundleReader
    from cags_common.bundle.player import BundlePlayer

    reader = BundleReader.open(str(bench.bundle))
    try:
        player = BundlePlayer(reader, lod)
        start = reader.manifest.gof_starts[reader.manifest.gof_of(bench.moment.frame)]
        for frame in range(start, bench.moment.frame):
            player.frame(frame)
        return player.frame(bench.moment.frame).splats
    finally:
        reader.close()


def _whole_frame(bench: Workbench) -> Stage:
    """Draw, align and restore: every combination of exactness, erosion and tier, judged by the picture shown."""
    moment = bench.moment
    scene = raster.create("auto").load(decoded_splats(bench, lod=2))
    tiers = [name for name in ("none", "affine", "lite") if name in restore.RESTORERS]
    points = []
    for exactness, iterations, tier in product(Exactness, (0, 8), tiers):
        if tier == "none" and iterations:
            continue  # nothing reads the aligned picture
        points.append(_combination(moment, scene, exactness, iterations, tier))
    return Stage(
        "client frame", "exactness / erosion / tier", "client", "restored_psnr_db", tuple(points), repetitions=3
    )


def _combination(moment: Moment, scene: RasterScene, exactness: Exactness, iterations: int, tier: str) -> Point:
    aligner = align.create("auto", AlignSettings(erosion_iterations=iterations))
    restorer = restore.create(tier)

    def run() -> F32:
        view = scene.render(moment.camera, RenderOptions(exactness=exactness))
        distorted = view.rgb.clip(0, 1)
        if tier == "none":
            return distorted
        assert view.depth is not None
        aligned = aligner.align(_reference(moment), view.depth, moment.camera)
        return restorer.restore(RestoreInput(distorted, view.alpha, aligned, _reference(moment)))

    shipped = (exactness, iterations, tier) == (Exactness.BALANCED, 8, "affine")
    return Point(
        f"{exactness.value} / {iterations} / {tier}",
        run,
        lambda rgb: {"restored_psnr_db": psnr(rgb, moment.truth)},
        default=shipped,
    )
