"""The measurement behind ``cags-bench align``."""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cags_bench.bundles import cached_bundle
from cags_bench.jsonl import check, provenance, summary
from cags_bench.references import REFERENCE_PX, coded_reference, moved, size_of
from cags_client.adapt import SirtAdapter
from cags_client.align import Aligned, AlignSettings, ReferencePicture, create
from cags_client.restore import RestoreInput
from cags_client.restore.affine import AffineRestorer, AffineSettings
from cags_common import raster
from cags_common.bundle import BundleReader
from cags_common.bundle.player import BundlePlayer
from cags_common.geometry import F32, Camera, Intrinsics
from cags_common.metrics import covered_mask, psnr, ssim
from cags_common.poses import Focus, synthetic_walk
from cags_common.raster.base import Footprint, RasterScene, RenderOptions
from cags_common.splats import Splats
from cags_encoder import EncodeSettings
from cags_server.settings import ServerSettings

CRF = ServerSettings().reference_crf
MARGIN = 1.2
"""The reference's field of view against the client's, in tangents."""

LOD_SHARES = (0.1, 0.2, 0.33, 0.67)
ADAPTER_STEPS = 6
"""References that the adapter has seen of a view: a fifth of a second's."""

MIDDLE_DB = (24.0, 29.0)
"""What counts as the middle of the ladder: PSNR of the distorted picture over covered pixels."""

POSE_ERRORS = ((0.0, 0.0), (2.0, 0.05), (5.0, 0.1))
"""Degrees, and metres in radii of the scene."""

FOV_RAD = math.radians(60.0)


@dataclass(frozen=True, eq=False)
class _Case:
    lod: int
    error_deg: float
    camera: Camera
    reference: ReferencePicture
    truth: F32
    covered: Any
    scene: RasterScene
    splats: Splats


def measure(args: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Lines of the benchmark."""
    bundle = cached_bundle(args.scene, args.cache, EncodeSettings(frames=1))
    with BundleReader.open(str(bundle)) as reader:
        bench = _Bench(reader, args)
        records = []
        for case in bench.cases():
            record = bench.quality(case)
            records.append(record)
            yield {"benchmark": "align", "scene": args.scene, "size": args.size, **record, **provenance()}
        times = bench.times()
        yield {"benchmark": "align", "size": args.size, "threads": args.threads, **times, **provenance()}
    yield summary("align", list(_checks(records, times, bench.top, args.size)), size=args.size)


class _Bench:
    def __init__(self, reader: BundleReader, args: argparse.Namespace) -> None:
        width, height = size_of(args.size)
        self.top = reader.manifest.lods - 1
        self._reader, self._args = reader, args
        focal = width / (2 * math.tan(FOV_RAD / 2))
        self._view = Intrinsics(width, height, focal, focal, width / 2, height / 2)
        w, h = REFERENCE_PX
        wide = focal * w / width / MARGIN
        self._reference_view = Intrinsics(w, h, wide, wide, w / 2, h / 2)
        self._options = RenderOptions(threads=args.threads)
        footprint = Footprint.of(self._view, self._reference_view)
        self._reference_options = RenderOptions(footprint=footprint, threads=args.threads)
        self._rasteriser = raster.create("auto")
        self._aligner = create("auto", AlignSettings(threads=args.threads))
        self._bare = create("auto", AlignSettings(threads=args.threads, erosion_iterations=0))
        self._unaligned = create("unaligned", AlignSettings(threads=args.threads))
        self._affine = AffineRestorer(AffineSettings(threads=args.threads))

    def cases(self) -> Iterator[_Case]:
        """Every LoD of a few, every pose error, every view."""
        m = self._reader.manifest
        source = self._rasteriser.load(self._reader.source(0).splats)
        walk = synthetic_walk("walking", Focus(m.focus_centre, m.focus_radius, m.up), seed=self._args.seed)
        lods = sorted({0, *(round(share * self.top) for share in LOD_SHARES), self.top})
        held = {lod: BundlePlayer(self._reader, lod).frame(0).splats for lod in lods}
        scenes = {lod: self._rasteriser.load(splats) for lod, splats in held.items()}
        rng = np.random.default_rng(self._args.seed)
        for view in range(self._args.views):
            camera = Camera(self._view, walk.pose_at(1_000_000 + view * 9_000_000), m.near)
            seen = source.render(camera, self._options)
            truth, covered = np.clip(seen.rgb, 0, 1), covered_mask(seen.alpha)
            for degrees, radii in POSE_ERRORS:
                axis, step = (v / np.linalg.norm(v) for v in rng.standard_normal((2, 3)))
                pose = moved(camera.pose, math.radians(degrees), radii * m.focus_radius, axis, step)
                there = Camera(self._reference_view, pose, m.near)
                reference = coded_reference(source, there, self._reference_options, fps=m.fps, crf=CRF)
                for lod in lods:
                    yield _Case(lod, degrees, camera, reference, truth, covered, scenes[lod], held[lod])

    def quality(self, case: _Case) -> dict[str, Any]:
        """PSNR over covered pixels and SSIM of one case."""
        given, aligned = self._inputs(case)
        pictures = {
            "distorted": given.distorted,
            "aligned": _swapped(given, aligned),
            "without_erosion": _swapped(given, self._bare.align(case.reference, aligned.geometry.depth, case.camera)),
            "affine": self._affine.restore(given),
            "affine_without_prpa": self._affine.restore(
                replace(given, aligned=self._unaligned.align(case.reference, aligned.geometry.depth, case.camera))
            ),
            **self._adapted(case),
        }
        record: dict[str, Any] = {"lod": case.lod, "error_deg": case.error_deg}
        record["occluded"] = float(aligned.occluded.mean())
        for name, picture in pictures.items():
            record[f"psnr_covered_{name}_db"] = psnr(picture, case.truth, case.covered)
            record[f"ssim_{name}"] = ssim(picture, case.truth)
        self._last = case
        return record

    def _adapted(self, case: _Case) -> dict[str, F32]:
        """The client's own picture after some steps of the colour adapter, and what ``affine`` makes of it."""
        scene, adapter = self._rasteriser.load(case.splats), SirtAdapter(len(case.splats))
        for _ in range(ADAPTER_STEPS):
            own = scene.render(case.reference.camera, self._reference_options)
            adapter.adapt(scene, case.splats, case.reference, own, self._reference_options)
        given, _ = self._inputs(replace(case, scene=scene))
        return {"adapted": given.distorted, "adapted_affine": self._affine.restore(given)}

    def times(self) -> dict[str, Any]:
        """Median milliseconds of each stage on the last case, interleaved, after a warm-up."""
        case = self._last
        given, _ = self._inputs(case)
        assert given.own is not None
        depth = case.scene.render(case.camera, self._options).depth
        assert depth is not None
        adapted, own = self._rasteriser.load(case.splats), given.own
        adapter = SirtAdapter(len(case.splats))
        stages: dict[str, Callable[[], object]] = {
            "raster": lambda: case.scene.render(case.camera, self._options),
            "own": lambda: case.scene.render(case.reference.camera, self._reference_options),
            "align": lambda: self._aligner.align(case.reference, depth, case.camera),
            "align_and_paint": lambda: self._aligner.align(case.reference, depth, case.camera).rgb,
            "affine": lambda: self._affine.restore(given),
            "adapt": lambda: adapter.adapt(adapted, case.splats, case.reference, own, self._reference_options),
        }
        spent: dict[str, list[float]] = {name: [] for name in stages}
        for _ in range(self._args.repetitions + 1):
            for name, stage in stages.items():
                start = time.perf_counter()
                stage()
                spent[name].append((time.perf_counter() - start) * 1e3)
        medians = {f"ms_{name}": statistics.median(values[1:]) for name, values in spent.items()}
        return {**medians, **{f"ms_{name}_least": min(values[1:]) for name, values in spent.items()}}

    def _inputs(self, case: _Case) -> tuple[RestoreInput, Aligned]:
        view = case.scene.render(case.camera, self._options)
        assert view.depth is not None
        aligned = self._aligner.align(case.reference, view.depth, case.camera)
        own = case.scene.render(case.reference.camera, self._reference_options)
        return RestoreInput(np.clip(view.rgb, 0, 1), view.alpha, aligned, case.reference, own), aligned


def _swapped(given: RestoreInput, aligned: Aligned) -> F32:
    """The aligned reference where it says something, erosion's fillings where it says nothing, else the distorted."""
    share = np.maximum(aligned.confidence, aligned.occluded)[..., None]
    return np.asarray(given.distorted + share * (aligned.rgb - given.distorted), dtype=np.float32)


def _checks(records: list[dict[str, Any]], times: dict[str, Any], top: int, size: str) -> Iterator[dict[str, Any]]:
    def gain(lod: int | None = None, error: float | None = None) -> list[float]:
        chosen = [r for r in records if lod in (None, r["lod"]) and error in (None, r["error_deg"])]
        return [r["psnr_covered_affine_db"] - r["psnr_covered_distorted_db"] for r in chosen]

    base = statistics.mean(gain(0))
    yield check("gain at the base LoD, dB", ">= 4.5", base, base >= 4.5)
    low, high = MIDDLE_DB
    middle = [g for r, g in zip(records, gain(), strict=True) if low <= r["psnr_covered_distorted_db"] <= high]
    if middle:
        value = statistics.mean(middle)
        yield check("gain where distorted is 24-29 dB, dB", ">= 2 (an object), >= 5 (a room)", value, value >= 2)
    yield check("least gain at the top, dB", ">= -0.1", min(gain(top)), min(gain(top)) >= -0.1)
    yield check("least gain of any view at any LoD, dB", ">= -0.1", min(gain()), min(gain()) >= -0.1)
    kept = statistics.mean(gain(0, 5.0)) / max(statistics.mean(gain(0, 0.0)), 1e-6)
    yield check("gain kept at 5 degrees, base LoD", ">= 0.8", kept, kept >= 0.8)
    hidden = max(r["occluded"] for r in records if r["error_deg"] == 0)
    yield check("pixels called occluded under an identity", "0", hidden, hidden == 0)
    if size == "1600x1200":
        paint, affine = times["ms_align_and_paint"], times["ms_affine"]
        yield check("alignment with erosion, ms", "<= 6", paint, paint <= 6)
        yield check("affine, ms", "<= 10", affine, affine <= 10)
        frame = times["ms_raster"] + times["ms_own"] + times["ms_align"] + affine
        yield check("client frame, ms", "<= 33", frame, frame <= 33)
    yield check("one adapter step at 400x300, ms", "<= 15", times["ms_adapt"], times["ms_adapt"] <= 15)
