"""Stages that reduce a scene: Draco's level, steps of k-means, and removal of splats that hardly contribute."""

from __future__ import annotations

from collections.abc import Callable

import DracoPy
import numpy as np

from cags_bench.cost.engine import Outcome, Point, Stage
from cags_bench.cost.moments import Workbench, psnr
from cags_common import raster
from cags_common.geometry import F32, Camera
from cags_common.raster.base import RasterScene, RenderedView, RenderOptions
from cags_common.splats import Splats
from cags_common.tiles.morton import morton_order
from cags_common.tiles.payloads import DRACO_LEVEL
from cags_encoder import EncodeSettings
from cags_encoder.quantiser.kmeans import ITERATIONS, NearestCentre, kmeans

TILE_SPLATS = 8_000
POSITION_BITS = 14
CLUSTERS = 256


def shrinking_stages(bench: Workbench) -> list[Stage]:
    """Stages that do not draw."""
    splats = bench.moment.source
    return [_draco_level(splats), _kmeans_steps(splats)]


def pruning_stages(bench: Workbench) -> list[Stage]:
    """Drawing without splats."""
    return [_pruning(bench)]


def _draco_level(splats: Splats) -> Stage:
    """Positions of one tile, encoded and decoded. Draco is lossless here, so bytes are the quality."""
    means = splats.means[morton_order(splats.means)][:TILE_SPLATS].astype(np.float64)
    low = means.min(axis=0)
    cells = np.rint((means - low) / (np.ptp(means, axis=0).max() or 1.0) * (2**POSITION_BITS - 1)).astype(np.float32)

    def coder(level: int) -> Callable[[], bytes]:
        def run() -> bytes:
            data: bytes = DracoPy.encode(
                cells,
                quantization_bits=POSITION_BITS,
                quantization_range=float(2**POSITION_BITS - 1),
                quantization_origin=np.zeros(3),
                compression_level=level,
                preserve_order=True,
            )
            DracoPy.decode(data)
            return data

        return run

    def judge(data: bytes) -> Outcome:
        return {"bytes_per_splat": len(data) / len(cells)}

    points = tuple(
        Point(str(n), coder(n), judge, default=n == DRACO_LEVEL) for n in sorted({0, 3, 5, 7, 10, DRACO_LEVEL})
    )
    return Stage("Draco", "compression level", "encoder, client", "bytes_per_splat", points, sized=False)


def _kmeans_steps(splats: Splats) -> Stage:
    scales = splats.log_scales

    def trainer(steps: int) -> Callable[[], F32]:
        return lambda: kmeans(scales, CLUSTERS, seed=0, iterations=steps)

    def judge(centres: F32) -> Outcome:
        nearest = centres[NearestCentre(centres)(scales)]
        return {"error_rms": float(np.sqrt(np.mean(np.square(nearest - scales, dtype=np.float64))))}

    points = tuple(
        Point(str(n), trainer(n), judge, default=n == ITERATIONS) for n in sorted({2, 5, 10, 20, 40, ITERATIONS})
    )
    knob = f"Lloyd steps, {CLUSTERS} centres of scale"
    return Stage("k-means", knob, "encoder", "error_rms", points, sized=False)


def _pruning(bench: Workbench) -> Stage:
    """Draw without the splats that contribute least to the moments' pictures."""
    moment, splats = bench.moment, bench.moment.source
    whole = raster.create("auto").load(splats)
    truth = whole.render(moment.camera, RenderOptions()).rgb
    weight = sum(_contribution(whole, m.camera) for m in bench.moments)
    order = np.argsort(weight, kind="stable")

    def point(share: float) -> Point:
        kept = np.sort(order[round(share * len(splats)) :])
        scene = raster.create("auto").load(splats.take(kept))

        def judge(view: RenderedView) -> Outcome:
            return {"psnr_db": psnr(view.rgb, truth), "kept_share": len(kept) / len(splats)}

        def run() -> RenderedView:
            return scene.render(moment.camera, RenderOptions())

        return Point(f"{share:.0%} left out", run, judge, share == shipped)

    shipped = EncodeSettings().prune
    shares = sorted({0.8, 0.6, 0.4, 0.2, 0.0, shipped}, reverse=True)
    return Stage("pruning", "share", "encoder, client", "psnr_db", tuple(map(point, shares)), costs=("kept_share",))


def _contribution(scene: RasterScene, camera: Camera) -> F32:
    found = scene.render(camera, RenderOptions(contribution=True)).contribution
    assert found is not None
    return found
