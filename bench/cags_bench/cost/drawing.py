"""Stages of drawing: the client's render."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cags_bench.cost.engine import Outcome, Point, Stage
from cags_bench.cost.moments import Workbench
from cags_common import raster
from cags_common.geometry import F32, Camera
from cags_common.metrics import psnr
from cags_common.raster.base import DepthKind, Exactness, RasterScene, RenderedView, RenderOptions

BEST_DB = 99.0


def drawing_stages(bench: Workbench) -> list[Stage]:
    """Settings of the rasteriser."""
    moment = bench.moment
    scene = raster.create("auto").load(moment.source)
    best = scene.render(moment.camera, RenderOptions(exactness=Exactness.EXACT))
    return [
        _exactness(scene, moment.camera, best),
        _sh_degree(scene, moment.camera, best),
        _depth_kind(bench),
        _threads(scene, moment.camera, best),
        _picture_size(scene, moment.camera, best),
    ]


def _against(best: RenderedView) -> Callable[[RenderedView], Outcome]:
    return lambda view: {"psnr_db": min(psnr(view.rgb, best.rgb), BEST_DB)}


def _render(scene: RasterScene, camera: Camera, options: RenderOptions) -> Callable[[], RenderedView]:
    return lambda: scene.render(camera, options)


def _exactness(scene: RasterScene, camera: Camera, best: RenderedView) -> Stage:
    points = tuple(
        Point(
            level.value,
            _render(scene, camera, RenderOptions(exactness=level)),
            _against(best),
            level is Exactness.BALANCED,
        )
        for level in Exactness
    )
    return Stage("rasterise", "exactness", "client", "psnr_db", points)


def _sh_degree(scene: RasterScene, camera: Camera, best: RenderedView) -> Stage:
    points = tuple(
        Point(str(degree), _render(scene, camera, RenderOptions(max_sh_degree=degree)), _against(best), degree == 3)
        for degree in range(4)
    )
    return Stage("view-dependent colour", "max_sh_degree", "client", "psnr_db", points)


def _depth_kind(bench: Workbench) -> Stage:
    """Depth is judged by the quality of the picture that is corrected with it."""
    from cags_bench.cost.serving import Referring

    moment = bench.moment
    referring = Referring(moment)
    reference = referring.received(referring.made())
    held = moment.view()
    assert held.depth is not None
    plane = np.full_like(held.depth, np.median(held.depth[np.isfinite(held.depth)]))  # no depth: one plane

    def judge(view: RenderedView) -> Outcome:
        seen = replace(view, depth=plane if view.depth is None else view.depth)
        return {"corrected_psnr_db": psnr(referring.corrected(reference, seen), moment.truth)}

    points = tuple(
        Point(
            kind.value,
            _render(moment.held, moment.camera, RenderOptions(depth=kind)),
            judge,
            kind is DepthKind.EXPECTED,
        )
        for kind in DepthKind
    )
    return Stage("depth", "kind", "client", "corrected_psnr_db", points)


def _threads(scene: RasterScene, camera: Camera, best: RenderedView) -> Stage:
    points = tuple(
        Point(str(n), _render(scene, camera, RenderOptions(threads=n)), _against(best), n == 2) for n in (1, 2, 4)
    )
    return Stage("threads", "threads", "client", "psnr_db", points)


def _picture_size(scene: RasterScene, camera: Camera, best: RenderedView) -> Stage:
    import cv2

    def point(divisor: int) -> Point:
        small = replace(
            camera, intrinsics=camera.intrinsics.resized(camera.width_px // divisor, camera.height_px // divisor)
        )

        def run() -> F32:
            rgb = scene.render(small, RenderOptions()).rgb
            if divisor == 1:
                return rgb
            return np.asarray(cv2.resize(rgb, (camera.width_px, camera.height_px), interpolation=cv2.INTER_LINEAR))

        return Point(
            f"1/{divisor}", run, lambda rgb: {"psnr_db": min(psnr(rgb, best.rgb), BEST_DB)}, default=divisor == 1
        )

    return Stage("picture size", "drawn at", "client", "psnr_db", (point(4), point(2), point(1)))
