"""Cost of a frame's effects, and the gain from enabling only what is needed, timed in the client's own pipeline."""

from __future__ import annotations

import time
from collections.abc import Sequence
from statistics import median
from typing import Any

from cags_bench.cost.engine import Measured, Outcome, Point, Stage
from cags_bench.cost.moments import JUDGED_LOD, Workbench, psnr
from cags_bench.cost.serving import DIFFERENCES
from cags_bench.jsonl import check
from cags_client.frame.pipeline import ClientPipeline
from cags_client.frame.presented import PresentedFrame
from cags_client.settings import ClientSettings
from cags_common.bundle import BundleReader
from cags_common.bundle.player import BundlePlayer
from cags_common.geometry import Camera
from cags_common.passes import ALWAYS, NEEDED, POLICIES
from cags_common.raster import create
from cags_common.raster.base import Footprint, RenderOptions
from cags_protocol.wire.limits import PROTOCOL_VERSION
from cags_protocol.wire.messages import FrameEnd, Hello, Mark, ReferenceFrame, ReferenceKind, TileLayers
from cags_server.reference.coder import Coded, ReferenceCoder

IN_PART, WHOLE = "effects, scene held in part", "effects, whole scene held"
"""Names of the stages."""

MOST = 1.05
"""Largest ratio of times. They differ at most by a depth picture and a band of colours; 5 % may be noise."""

DECISIONS = 3
"""Number of frames for the time outside the stages."""


def effect_stages(bench: Workbench) -> list[Stage]:
    """The first key frame, at a low level and complete, with all effects and with those needed."""
    reader = BundleReader.open(str(bench.bundle))
    depths = {IN_PART: min(JUDGED_LOD, reader.manifest.lods - 1) + 1, WHOLE: reader.manifest.lods}
    return [
        Stage(name, "policy", "client", "corrected_psnr_db", tuple(_point(bench, reader, p, lods) for p in POLICIES))
        for name, lods in depths.items()
    ]


def effect_checks(groups: Sequence[Sequence[Measured]]) -> list[dict[str, Any]]:
    """Checks that an effect that is off costs no time, and that deciding costs little; the worst of all sizes."""
    ratios = []
    for group in groups:
        if group[0].stage.name == WHOLE:
            by_policy = {one.label: one.median_ms for one in group}
            ratios.append(by_policy[NEEDED] / by_policy[ALWAYS])
    every = [one for group in groups for one in group if group[0].stage.name in (IN_PART, WHOLE)]
    ratio, outside = max(ratios), max(one.mean("outside_ms") for one in every)
    return [
        check(
            "whole scene: time of what is needed over that of everything", f"<= {MOST}", round(ratio, 3), ratio <= MOST
        ),
        check("deciding effects, and a frame's figures [ms]", "<= 0.5", round(outside, 3), outside <= 0.5),
    ]


def _point(bench: Workbench, reader: BundleReader, policy: str, lods: int) -> Point:
    i = bench.moment.camera.intrinsics
    settings = ClientSettings(width=i.width_px, height=i.height_px, effects=policy)
    pipeline = ClientPipeline(reader.manifest, settings, clock=time.perf_counter)
    pipeline.on_codebooks(reader.codebooks())
    _fill(pipeline, reader, lods)
    _refer(pipeline, reader, bench, lods)
    camera = bench.moment.camera
    truth = create("auto").load(reader.source(0).splats).render(camera, RenderOptions()).rgb.clip(0, 1)

    def judge(shown: PresentedFrame) -> Outcome:
        outside = median(_outside_ms(pipeline, camera) for _ in range(DECISIONS))
        return {"corrected_psnr_db": psnr(shown.rgb, truth), "effects_on": len(shown.effects.on), "outside_ms": outside}

    return Point(policy, lambda: pipeline.present(0, camera), judge, default=policy == ClientSettings().effects)


def _outside_ms(pipeline: ClientPipeline, camera: Camera) -> float:
    """Time of one frame outside its stages: deciding the effects, and statistics."""
    started = time.perf_counter()
    shown = pipeline.present(0, camera)
    return (time.perf_counter() - started) * 1e3 - sum(shown.stages_ms.values())


def _fill(pipeline: ClientPipeline, reader: BundleReader, lods: int) -> None:
    """Deliver the first frame up to LoD ``lods`` - 1."""
    for entry in reader.frame(0).tiles:
        levels = min(lods, len(entry.lod_bytes))
        parts = [reader.payload(0, entry.tile, lod) for lod in range(levels)]
        message = TileLayers(0, entry.tile, 0, levels, tuple(map(len, parts)))
        pipeline.on_tiles([(message, memoryview(b"".join(parts)))])
    pipeline.on_frame_end(FrameEnd(0), memoryview(reader.removed_payload(0)))


def _refer(pipeline: ClientPipeline, reader: BundleReader, bench: Workbench, lods: int) -> None:
    """Deliver the reference of the first frame from the moment's reference camera. With all levels it is empty."""
    basis = 1
    pipeline.on_mark(Mark(basis))
    camera = bench.moment.reference_camera
    reference_camera = Camera(camera.intrinsics, camera.pose, reader.manifest.near)
    whole = lods == reader.manifest.lods
    coded = Coded(ReferenceKind.NOTHING) if whole else _coded(reader, bench, lods, reference_camera)
    says = coded.kind is not ReferenceKind.NOTHING
    message = ReferenceFrame(
        0,
        int(says),
        reference_camera.pose,
        reference_camera.intrinsics,
        idr=says,
        kind=coded.kind.value,
        basis=basis,
        knee=coded.knee,
    )
    pipeline.on_reference(message, memoryview(coded.access_unit))


def _coded(reader: BundleReader, bench: Workbench, lods: int, reference_camera: Camera) -> Coded:
    """The first frame's reference for a client that holds ``lods`` levels."""
    held = BundlePlayer(reader, lods - 1).frame(0).splats
    options = RenderOptions(footprint=Footprint.of(bench.moment.camera.intrinsics, reference_camera.intrinsics))
    truth, own = (
        create("auto").load(splats).render(reference_camera, options).rgb.clip(0, 1)
        for splats in (reader.source(0).splats, held)
    )
    hello = Hello(PROTOCOL_VERSION, bench.moment.camera.intrinsics, reference_camera.pose)
    return ReferenceCoder(DIFFERENCES, hello, reader.manifest.fps).code(truth, own, idr=True)
