"""Stages of the server's reference: its size, footprint, quality and colour sampling, alone and together."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from cags_bench.cost.engine import Outcome, Point, Stage
from cags_bench.cost.moments import Workbench
from cags_client.align import ReferencePicture
from cags_client.restore import create
from cags_common import raster
from cags_common.geometry import F32, Camera
from cags_common.metrics import psnr
from cags_common.raster.base import Footprint, RasterScene, RenderOptions
from cags_common.video.colour import Chroma
from cags_common.video.h264 import H264Decoder, H264Encoder
from cags_server.settings import ServerSettings

SHIPPED = ServerSettings()
SHIPPED_SIZE = SHIPPED.reference_width, SHIPPED.reference_height
SHIPPED_CHROMA = Chroma(SHIPPED.reference_chroma)
"""What the server does when it is not told otherwise."""

SIZES = ((200, 150), (400, 300), (800, 600))
CRFS = (34.0, 28.0, 24.0, 20.0, 16.0)
COMBINED_CRFS = (28.0, 20.0, 16.0)


def reference_stages(bench: Workbench) -> list[Stage]:
    """Drawing and coding a reference, judged by the picture that a client restores with it."""
    scene = raster.create("auto").load(bench.moment.source)
    return [
        _reference_size(bench, scene),
        _reference_footprint(bench, scene),
        _reference_quality(bench, scene),
        _reference_chroma(bench, scene),
        _whole_reference(bench, scene),
    ]


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
    crf: float = SHIPPED.reference_crf,
) -> Point:
    """Draw and code; ``footprint`` None is the client's own."""
    camera = _reference_camera(bench, *size)
    used = footprint or Footprint.of(bench.moment.camera.intrinsics, camera.intrinsics)

    def run() -> tuple[bytes, F32]:
        return _sent(camera, scene.render(camera, RenderOptions(footprint=used)).rgb, crf, SHIPPED_CHROMA)

    def judge(sent: tuple[bytes, F32]) -> Outcome:
        return {"bytes": len(sent[0]), "restored_psnr_db": _restored(bench, camera, sent[1])}

    return Point(label, run, judge, default)


def _reference_size(bench: Workbench, scene: RasterScene) -> Stage:
    points = tuple(
        _reference_point(bench, scene, f"{w}x{h}", (w, h), None, default=(w, h) == SHIPPED_SIZE) for w, h in SIZES
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
        _coded(bench, scene, f"crf {crf:g}", crf, SHIPPED_CHROMA, default=crf == SHIPPED.reference_crf) for crf in CRFS
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


def _whole_reference(bench: Workbench, scene: RasterScene) -> Stage:
    """Every combination of size and quality: a large coarse picture against a small fine one."""
    points = tuple(
        _reference_point(
            bench,
            scene,
            f"{w}x{h} / crf {crf:g}",
            (w, h),
            None,
            default=((w, h), crf) == (SHIPPED_SIZE, SHIPPED.reference_crf),
            crf=crf,
        )
        for (w, h), crf in product(SIZES, COMBINED_CRFS)
    )
    return Stage("whole reference", "size / quality", "server", "restored_psnr_db", points, repetitions=3)
