"""Tables and figures of the codec: levels of quantisation, layers, the ladder, and what a reference adds."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cags_bench.bundles import cached_bundle
from cags_bench.jsonl import JsonObject
from cags_bench.reproduce.plan import Context
from cags_bench.reproduce.section import Cell, Curve, Plot, Section
from cags_bench.seeing import see
from cags_common import correction, raster
from cags_common.bundle import BundleReader
from cags_common.bundle.codecs import dequantise_tiles
from cags_common.bundle.player import BundlePlayer
from cags_common.correction import Reference
from cags_common.geometry import F32, Camera, Intrinsics
from cags_common.metrics import psnr, ssim
from cags_common.poses import Focus, open_poses
from cags_common.raster.base import Footprint, RenderOptions
from cags_common.splats import Splats
from cags_common.tiles.dequantise import Dequantiser
from cags_common.tiles.kinds import TileKind
from cags_common.tiles.lod import LodLayer
from cags_common.tiles.payloads import decode_base
from cags_common.tiles.state import TileState
from cags_common.tiles.svq import CodebookSet
from cags_encoder import EncodeSettings

VIEWS = 4
MOTIVATION_STEPS = 5

PAPER_SVQ: tuple[tuple[Cell, ...], ...] = (
    ("paper: SVQ 66 bit, Neural 3D Video", 24.5, 0.901, 2.00, None, 15.0),
    ("paper: SVQ 76 bit, Neural 3D Video", 25.1, 0.907, 2.14, None, 15.0),
    ("paper: SVQ 66 bit, Meeting Room", 26.0, 0.887, 1.53, None, 18.0),
    ("paper: SVQ 76 bit, Meeting Room", 26.4, 0.894, 1.69, None, 19.0),
    ("paper: SVQ 66 bit, Dynamic 3DGS", 25.3, 0.883, 2.25, None, 28.0),
    ("paper: SVQ 76 bit, Dynamic 3DGS", 23.3, 0.874, 2.42, None, 29.0),
)


@dataclass(frozen=True)
class Stills:
    """Views of a first frame: the truth, and cameras to judge from."""

    bundle: Path
    cameras: tuple[Camera, ...]
    truths: tuple[F32, ...]
    source: Splats

    def views(self, splats: Splats) -> list[F32]:
        """The splats from every camera."""
        scene = raster.create("auto").load(splats)
        return [scene.render(camera, RenderOptions()).rgb.clip(0, 1) for camera in self.cameras]

    def quality(self, splats: Splats) -> tuple[float, float]:
        """Mean PSNR and SSIM against the truth."""
        views = self.views(splats)
        scores = [(psnr(v, t), ssim(v, t)) for v, t in zip(views, self.truths, strict=True)]
        return sum(s[0] for s in scores) / len(scores), sum(s[1] for s in scores) / len(scores)


def _stills(context: Context, scene: str, quantiser: str) -> Stills:
    settings = EncodeSettings(frames=1)
    if quantiser:
        settings = replace(settings, quantiser=quantiser)
    bundle = cached_bundle(scene, context.runner.bundles, settings)
    reader = BundleReader.open(str(bundle))
    manifest, source = reader.manifest, reader.source(0).splats
    reader.close()
    focus = Focus(manifest.focus_centre, manifest.focus_radius, manifest.up)
    walk = open_poses(context.plan.poses, focus, window_us=4_000_000)
    client = _intrinsics(context)
    cameras = tuple(Camera(client, walk.pose_at(i * 4_000_000 // VIEWS), manifest.near) for i in range(VIEWS))
    loaded = raster.create("auto").load(source)
    truths = tuple(loaded.render(camera, RenderOptions()).rgb.clip(0, 1) for camera in cameras)
    return Stills(bundle, cameras, truths, source)


def _intrinsics(context: Context) -> Intrinsics:
    from cags_client.settings import ClientSettings

    return ClientSettings(width=context.plan.width, height=context.plan.height).intrinsics


def svq(context: Context) -> Section:
    """The highest level of each configuration: quality, size, decoding time."""
    rows: list[list[Cell]] = [list(row) for row in PAPER_SVQ]
    for scene in context.plan.scenes:
        for quantiser in ("paper-66", "paper-76", ""):
            context.tell(f"svq, {scene}, {quantiser or 'default'}")
            stills = _stills(context, scene, quantiser)
            reader = BundleReader.open(str(stills.bundle))
            started = time.perf_counter()
            decoded = BundlePlayer(reader).frame(0).splats
            decode_ms = (time.perf_counter() - started) * 1e3
            size = sum(sum(tile.lod_bytes) for tile in reader.frame(0).tiles)
            reader.close()
            found = stills.quality(decoded)
            rows.append([f"{quantiser or 'default'}, {scene}", *found, size / 1e6, size / len(decoded), decode_ms])
    return Section(
        name="svq",
        title="Scalable vector quantisation at its highest level",
        paper="Table 1. Other codecs beside ours: cags-bench codec.",
        columns=("configuration", "PSNR [dB]", "SSIM", "size [MB]", "bytes a splat", "decoding [ms]"),
        rows=rows,
    )


def ladder(context: Context) -> Section:
    """Quality against size as LoDs are added in their order."""
    rows: list[list[Cell]] = []
    curves = []
    for scene in context.plan.scenes:
        for quantiser in ("paper-66", ""):
            context.tell(f"ladder, {scene}, {quantiser or 'default'}")
            stills = _stills(context, scene, quantiser)
            reader = BundleReader.open(str(stills.bundle))
            label, sizes, scores = f"{scene}, {quantiser or 'default'}", [], []
            steps = range(0, reader.manifest.lods, max(1, reader.manifest.lods // 12) if context.plan.quick else 1)
            for lod in sorted({*steps, reader.manifest.lods - 1}):
                size = sum(sum(tile.lod_bytes[: lod + 1]) for tile in reader.frame(0).tiles)
                quality, similarity = stills.quality(BundlePlayer(reader, lod).frame(0).splats)
                sizes.append(size / len(stills.source))
                scores.append(quality)
                rows.append([label, lod, size / len(stills.source), quality, similarity])
            curves.append(Curve(label, sizes, scores))
            reader.close()
    return Section(
        name="ladder",
        title="Quality against size along the LoD ladder",
        paper="Supplement, figure of interleaved layers.",
        columns=("scene, configuration", "LoD", "bytes a splat", "PSNR [dB]", "SSIM"),
        rows=rows,
        plots=[Plot("LoD ladder", "bytes a splat", "PSNR [dB]", curves)],
    )


def layers(context: Context) -> Section:
    """Each attribute decoded with more layers while the others are whole."""
    stills = _stills(context, context.plan.scenes[0], "")
    reader = BundleReader.open(str(stills.bundle))
    books = CodebookSet.from_bytes(reader.codebooks())
    rows: list[list[Cell]] = []
    curves = []
    for attribute in dict.fromkeys(item.attribute for item in reader.manifest.lod_order):
        context.tell(f"layers, {attribute}")
        own = [item for item in reader.manifest.lod_order if item.attribute == attribute]
        points = [_without(reader, books, stills, own[depth:]) for depth in range(len(own) + 1)]
        rows += [[attribute, depth, size, quality] for depth, (size, quality) in enumerate(points)]
        curves.append(Curve(attribute, [p[0] for p in points], [p[1] for p in points]))
    reader.close()
    return Section(
        name="layers",
        title="Quality against size of each attribute's layers",
        paper="Supplement, figure of layer quality: one attribute cut, the others whole.",
        columns=("attribute", "layers", "bytes a splat", "PSNR [dB]"),
        rows=rows,
        plots=[Plot(context.plan.scenes[0], "bytes a splat", "PSNR [dB]", curves)],
    )


def _without(reader: BundleReader, books: CodebookSet, stills: Stills, left_out: list[LodLayer]) -> tuple[float, float]:
    """Bytes a splat and PSNR when these layers are not sent."""
    tiles, size, dequantiser = [], 0, Dequantiser(books)
    for entry in reader.frame(0).tiles:
        if entry.kind is not TileKind.LOOKS:
            continue
        base = reader.payload(0, entry.tile, 0)
        state = TileState(decode_base(base, books), dequantiser, reader.manifest.lod_order)
        size += len(base)
        for lod, item in enumerate(reader.manifest.lod_order, start=1):
            if item not in left_out:
                payload = reader.payload(0, entry.tile, lod)
                state.add_layer(lod, payload)
                size += len(payload)
        tiles.append(state)
    shown = dequantise_tiles(tiles, reader.manifest.sh_degree)
    return size / len(stills.source), stills.quality(shown)[0]


def motivation(context: Context) -> Section:
    """Size against PSNR: the reference alone, the distorted picture alone, and correction by example."""
    rows: list[list[Cell]] = []
    plots = []
    for scene in context.plan.scenes:
        context.tell(f"motivation, {scene}")
        stills = _stills(context, scene, "paper-66")
        references = [_reference(stills, camera) for camera in stills.cameras]
        reader = BundleReader.open(str(stills.bundle))
        top = reader.manifest.lods - 1
        points: list[JsonObject] = []
        for step in range(MOTIVATION_STEPS):
            lod = round(top * step / (MOTIVATION_STEPS - 1))
            size = sum(sum(tile.lod_bytes[: lod + 1]) for tile in reader.frame(0).tiles)
            scores = _three_ways(stills, BundlePlayer(reader, lod).frame(0).splats, references)
            points.append({"bytes": size / len(stills.source), **scores})
            rows.append([scene, lod, points[-1]["bytes"], *scores.values()])
        reader.close()
        x = [p["bytes"] for p in points]
        curves = [Curve(key, x, [p[key] for p in points]) for key in points[0] if key != "bytes"]
        plots.append(Plot(scene, "bytes a splat", "PSNR [dB]", curves))
    return Section(
        name="motivation",
        title="Super-resolution, colours alone, and correction by example",
        paper="Figure 'motivation'. Five depths of the 66-bit ladder stand for the paper's five flat quantisers; "
        "references are rendered for the exact pose, as there.",
        columns=("scene", "LoD", "bytes a splat", "reference upsampled [dB]", "distorted [dB]", "by example [dB]"),
        rows=rows,
        plots=plots,
    )


def _reference(stills: Stills, camera: Camera) -> Reference:
    small = replace(camera, intrinsics=camera.intrinsics.resized(400, 300))
    footprint = Footprint.of(camera.intrinsics, small.intrinsics)
    rgb = raster.create("auto").load(stills.source).render(small, RenderOptions(footprint=footprint)).rgb
    return Reference(rgb.clip(0, 1), small, picture=True)


def _three_ways(stills: Stills, splats: Splats, references: list[Reference]) -> dict[str, Any]:
    import cv2

    scene, corrector = raster.create("auto").load(splats), correction.create("auto")
    sums = {"reference upsampled": 0.0, "distorted": 0.0, "by example": 0.0}
    for camera, truth, reference in zip(stills.cameras, stills.truths, references, strict=True):
        seen = see(scene, camera)
        corrected = seen.corrected(reference, corrector).rgb
        size = (camera.width_px, camera.height_px)
        up: F32 = np.asarray(cv2.resize(reference.coded, size, interpolation=cv2.INTER_LINEAR), np.float32)
        for key, picture in zip(sums, (up, seen.distorted, corrected), strict=True):
            sums[key] += psnr(picture, truth) / len(stills.cameras)
    return sums
