"""Stages that draw: the client's render and the server's reference."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cags_bench.cost.engine import Outcome, Point, Stage
from cags_bench.cost.moments import Workbench
from cags_client.align import ReferencePicture
from cags_client.restore import create
from cags_common import raster
from cags_common.geometry import F32, Camera
from cags_common.metrics import psnr
from cags_common.raster.base import DepthKind, Exactness, Footprint, RasterScene, RenderedView, RenderOptions
from cags_common.video.colour import Chroma
from cags_common.video.h264 import H264Decoder, H264Encoder
from cags_server.settings import ServerSettings

BEST_DB = 99.0

SHIPPED = ServerSettings()
SHIPPED_SIZE = SHIPPED.reference_width, SHIPPED.reference_height
SHIPPED_CHROMA = Chroma(SHIPPED.reference_chroma)
"""What the server does when it is not told otherwise."""


def drawing_stages(bench: Workbench) -> list[Stage]:
    """The rasteriser's knobs, and those of the reference: size, footprint, quality, colour sampling."""
    moment = bench.moment
    scene = raster.create("auto").load(moment.source)
    best = scene.render(moment.camera, RenderOptions(exactness=Exactness.EXACT))
    return [
        _exactness(scene, moment.camera, best),
        _sh_degree(scene, moment.camera, best),
        _depth_kind(bench, scene),
        _threads(scene, moment.camera, best),
        _picture_size(scene, moment.camera, best),
        _reference_size(bench, scene),
        _reference_footprint(bench, scene),
        _reference_quality(bench, scene),
        _reference_chroma(bench, scene),
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


def _depth_kind(bench: Workbench, scene: RasterScene) -> Stage:
    """Depth is judged by what it is for: the aligned reference against the truth."""
    from cags_client import align

    moment, aligner = bench.moment, align.create("auto")

    def judge(view: RenderedView) -> Outcome:
        depth = view.depth if view.depth is not None else np.full(view.alpha.shape, bench_depth, np.float32)
        aligned = aligner.align(moment.reference, depth, moment.camera)
        known = aligned.confidence > 0
        return {"aligned_psnr_db": psnr(aligned.rgb, moment.truth, known) if known.any() else 0.0}

    finite = moment.seen.depth[np.isfinite(moment.seen.depth)]
    bench_depth = float(np.median(finite))  # without a depth picture: the whole view as one plane
    points = tuple(
        Point(kind.value, _render(scene, moment.camera, RenderOptions(depth=kind)), judge, kind is DepthKind.EXPECTED)
        for kind in DepthKind
    )
    return Stage("depth", "kind", "client", "aligned_psnr_db", points)


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


# ------------------------------------------------------------------------------------------------------------ reference


def _reference_camera(bench: Workbench, width: int, height: int) -> Camera:
    camera = bench.moment.reference.camera
    return replace(camera, intrinsics=camera.intrinsics.resized(width, height))


def _restored(bench: Workbench, camera: Camera, rgb: F32) -> float:
    """PSNR of the shipped restoration with this reference."""
    reference = ReferencePicture(np.ascontiguousarray(rgb.clip(0, 1)), camera, bench.moment.frame)
    return psnr(bench.moment.seen.restored(reference, create("affine")), bench.moment.truth)


def _sent(camera: Camera, rgb: F32, crf: float, chroma: Chroma) -> tuple[bytes, F32]:
    encoder = H264Encoder(camera.width_px, camera.height_px, 30, crf=crf, chroma=chroma)
    data = encoder.encode(rgb, idr=True)
    decoded = H264Decoder().decode(data)
    assert decoded is not None, "an IDR decodes by itself"
    return data, decoded


def _reference_point(
    bench: Workbench,
    scene: RasterScene,
    label: str,
    size: tuple[int, int],
    footprint: Footprint | None,
    *,
    default: bool,
) -> Point:
    camera = _reference_camera(bench, *size)
    used = footprint or Footprint.of(bench.moment.camera.intrinsics, camera.intrinsics)

    def run() -> tuple[bytes, F32]:
        return _sent(
            camera, scene.render(camera, RenderOptions(footprint=used)).rgb, SHIPPED.reference_crf, SHIPPED_CHROMA
        )

    def judge(sent: tuple[bytes, F32]) -> Outcome:
        return {"bytes": len(sent[0]), "restored_psnr_db": _restored(bench, camera, sent[1])}

    return Point(label, run, judge, default)


def _reference_size(bench: Workbench, scene: RasterScene) -> Stage:
    sizes = ((200, 150), (400, 300), (800, 600))
    points = tuple(
        _reference_point(bench, scene, f"{w}x{h}", (w, h), None, default=(w, h) == SHIPPED_SIZE) for w, h in sizes
    )
    return Stage("reference size", "width x height", "server", "restored_psnr_db", points)


def _reference_footprint(bench: Workbench, scene: RasterScene) -> Stage:
    kinds = {"plain": Footprint.classic(), "antialiased": Footprint.antialiased(), "client": None}
    points = tuple(
        _reference_point(bench, scene, name, SHIPPED_SIZE, footprint, default=footprint is None)
        for name, footprint in kinds.items()
    )
    return Stage("reference footprint", "footprint", "server", "restored_psnr_db", points)


def _coded(bench: Workbench, scene: RasterScene, label: str, crf: float, chroma: Chroma, *, default: bool) -> Point:
    camera = _reference_camera(bench, *SHIPPED_SIZE)
    options = RenderOptions(footprint=Footprint.of(bench.moment.camera.intrinsics, camera.intrinsics))
    drawn = scene.render(camera, options).rgb

    def judge(sent: tuple[bytes, F32]) -> Outcome:
        return {"bytes": len(sent[0]), "restored_psnr_db": _restored(bench, camera, sent[1])}

    return Point(label, lambda: _sent(camera, drawn, crf, chroma), judge, default)


def _reference_quality(bench: Workbench, scene: RasterScene) -> Stage:
    points = tuple(
        _coded(bench, scene, f"crf {crf:g}", crf, SHIPPED_CHROMA, default=crf == SHIPPED.reference_crf)
        for crf in (34.0, 28.0, 24.0, 20.0, 16.0)
    )
    return Stage("reference H.264 quality", "crf", "server", "restored_psnr_db", points)


def _reference_chroma(bench: Workbench, scene: RasterScene) -> Stage:
    choices = (
        ("4:2:0 crf 24", 24.0, Chroma.HALF),
        ("4:2:0 crf 20", 20.0, Chroma.HALF),
        ("4:4:4 crf 20", 20.0, Chroma.FULL),
        ("4:4:4 crf 24", 24.0, Chroma.FULL),
    )
    points = tuple(
        _coded(bench, scene, label, crf, chroma, default=(crf, chroma) == (SHIPPED.reference_crf, SHIPPED_CHROMA))
        for label, crf, chroma in choices
    )
    return Stage("reference colour sampling", "chroma", "server", "restored_psnr_db", points)
