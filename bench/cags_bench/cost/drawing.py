"""Stages of drawing: the client's render."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from cags_bench.cost.engine import Outcome, Point, Stage
from cags_bench.cost.moments import Workbench, psnr
from cags_client.settings import HALF, ClientSettings
from cags_common import raster
from cags_common.errors import ConfigError
from cags_common.geometry import F32, Camera
from cags_common.raster.base import DepthKind, Exactness, Rasteriser, RasterScene, RenderedView, RenderOptions

SHIPPED = ClientSettings()
"""Defaults of the client."""

OPTIONS = RenderOptions()
"""Defaults of the rasteriser."""


def drawing_stages(bench: Workbench) -> list[Stage]:
    """Settings of the rasteriser."""
    moment = bench.moment
    scene = raster.create("auto").load(moment.source)
    best = scene.render(moment.camera, RenderOptions(exactness=Exactness.EXACT))
    return [
        _exactness(bench, scene, best),
        _sh_degree(scene, moment.camera, best),
        _depth_kind(bench),
        _threads(scene, moment.camera, best),
        _picture_size(scene, moment.camera, best),
    ]


def _against(best: RenderedView) -> Callable[[RenderedView], Outcome]:
    return lambda view: {"psnr_db": psnr(view.rgb, best.rgb)}


def _render(scene: RasterScene, camera: Camera, options: RenderOptions) -> Callable[[], RenderedView]:
    return lambda: scene.render(camera, options)


@cache
def graphics() -> tuple[str, Rasteriser] | str:
    """Name of the graphics adapter and a rasteriser on it, or why there is none.

    A software adapter is taken where there is no other; its name says so.
    """
    from cags_gpu.device import Gpu, choose
    from cags_gpu.keeper import Keeper
    from cags_gpu.raster import GpuRasteriser

    try:
        adapter, _ = choose(software=True)
        return str(adapter), GpuRasteriser(Keeper(lambda: Gpu(software=True)))
    except ConfigError as error:
        return str(error)


def _exactness(bench: Workbench, scene: RasterScene, best: RenderedView) -> Stage:
    """Levels on the processor, and the default level on the graphics adapter where there is one."""
    camera, judge = bench.moment.camera, _against(best)
    on_processor = raster.chosen(SHIPPED.raster) != "gpu"
    points = [
        Point(
            f"cpu, {level.value}",
            _render(scene, camera, RenderOptions(exactness=level, threads=SHIPPED.threads)),
            judge,
            on_processor and level == SHIPPED.exactness,
        )
        for level in Exactness
    ]
    found = graphics()
    if not isinstance(found, str):
        adapter, rasteriser = found
        label = f"gpu, {SHIPPED.exactness}: {adapter}"
        options = RenderOptions(exactness=Exactness(SHIPPED.exactness))
        run = _render(rasteriser.load(bench.moment.source), camera, options)
        points.append(Point(label, run, judge, not on_processor))
    return Stage("rasterise", "backend, exactness", "client", "psnr_db", tuple(points))


def _sh_degree(scene: RasterScene, camera: Camera, best: RenderedView) -> Stage:
    default = OPTIONS.max_sh_degree
    points = tuple(
        Point(str(n), _render(scene, camera, RenderOptions(max_sh_degree=n)), _against(best), n == default)
        for n in sorted({0, 1, 2, 3, default})
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
    seen_at = held.depth[np.isfinite(held.depth)]
    plane = np.full_like(held.depth, np.median(seen_at) if len(seen_at) else 1.0)  # no depth: one plane

    def judge(view: RenderedView) -> Outcome:
        seen = replace(view, depth=plane if view.depth is None else view.depth)
        return {"corrected_psnr_db": psnr(referring.corrected(reference, seen), moment.truth)}

    points = tuple(
        Point(
            kind.value,
            _render(moment.held, moment.camera, RenderOptions(depth=kind)),
            judge,
            kind is OPTIONS.depth,
        )
        for kind in DepthKind
    )
    return Stage("depth", "kind", "client", "corrected_psnr_db", points)


def _threads(scene: RasterScene, camera: Camera, best: RenderedView) -> Stage:
    points = tuple(
        Point(str(n), _render(scene, camera, RenderOptions(threads=n)), _against(best), n == SHIPPED.threads)
        for n in sorted({1, 2, 4, SHIPPED.threads})
    )
    return Stage("threads", "threads", "client", "psnr_db", points)


def _picture_size(scene: RasterScene, camera: Camera, best: RenderedView) -> Stage:
    """Smaller pictures, enlarged; the product draws the whole size, and half of it where that is too slow."""
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

        return Point(f"1/{divisor}", run, lambda rgb: {"psnr_db": psnr(rgb, best.rgb)}, default=divisor == whole)

    whole = 2 if SHIPPED.resolution == HALF else 1
    return Stage("picture size", "drawn at", "client", "psnr_db", (point(4), point(2), point(1)))
