"""References of another media frame than the one on display: how much of the gain stays, and that nothing is lost.

A moving scene is played through the client's own pipeline at one LoD. ``late``: each frame's reference comes ``age``
frames after its own was shown. ``held``: it comes in time, and no other follows for ``age`` frames.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cags_bench.align.command import AlignBenchSettings
from cags_bench.bundles import cached_bundle
from cags_bench.jsonl import check, provenance, summary
from cags_bench.references import REFERENCE_PX, moved
from cags_client.pipeline import ClientPipeline
from cags_client.settings import ClientSettings
from cags_common import raster
from cags_common.bundle import BundleReader
from cags_common.geometry import F32, Camera, Intrinsics, Pose
from cags_common.metrics import covered_mask, psnr
from cags_common.poses import Focus, PoseTrace, synthetic_walk
from cags_common.raster.base import Footprint, RenderOptions
from cags_common.video.colour import Chroma
from cags_common.video.h264 import H264Decoder, H264Encoder
from cags_common.video.noise import coding_noise
from cags_encoder import EncodeSettings
from cags_protocol.messages import FrameEnd, ReferenceFrame, TileLayers

COMINGS = ("late", "held")
CHANGED = 0.02
"""A pixel of the truth that changes by more than this between two frames belongs to something that moves."""

MARGIN = 1.2
LOD_SHARES = (0.0, 0.3, 0.6)
ERROR_DEG = 2.0
STATS = ("mean", "least")


@dataclass(frozen=True)
class AgeCase:
    """One way of being out of date."""

    coming: str
    """``late`` or ``held``."""
    age: int
    """Media frames between the reference and the display."""
    lod: int
    """Of every tile."""
    error_deg: float = 0.0
    """Of the reference's pose, against the viewer's at the reference's frame."""


class AgedPlay:
    """Plays one bundle with references of another frame."""

    def __init__(self, reader: BundleReader, settings: ClientSettings, *, crf: float, seed: int = 0) -> None:
        m = reader.manifest
        self._reader, self._settings, self._crf = reader, settings, crf
        w, h = (min(a, b) for a, b in zip(REFERENCE_PX, (settings.width, settings.height), strict=True))
        wide = settings.intrinsics.fx_px * w / settings.width / MARGIN
        self._view = Intrinsics(w, h, wide, wide, w / 2, h / 2)
        self._walk: PoseTrace = synthetic_walk("walking", Focus(m.focus_centre, m.focus_radius, m.up), seed=seed)
        self._sources: dict[int, tuple[Any, Any]] = {}
        axis, step = (v / np.linalg.norm(v) for v in np.random.default_rng(seed).standard_normal((2, 3)))
        self._off = axis, step

    def pose(self, frame: int) -> Pose:
        """The viewer at a media frame."""
        return self._walk.pose_at(1_000_000 + round(frame * 1e6 / self._reader.manifest.fps))

    def play(self, case: AgeCase, frames: Sequence[int]) -> Iterator[dict[str, Any]]:
        """PSNR over covered pixels, and over those that move, of the distorted and the restored picture.

        ``frames`` are at least ``age`` apart, so that no older reference is nearer.
        """
        pipe = ClientPipeline(self._reader.manifest, self._reader.codebooks(), self._settings)
        wait = case.age if case.coming == "late" else 0
        for frame in range(max(frames) + 1):
            self._send(pipe, frame, case.lod)
            if frame - wait + case.age in frames:
                pipe.on_reference(*self._reference(frame - wait, case.error_deg))
            shown = pipe.present(frame, pipe.camera(self.pose(frame)))
            if frame in frames:
                yield {"frame": frame, **self._scored(frame, case.age, shown.distorted, shown.rgb)}

    def _scored(self, frame: int, age: int, distorted: F32, restored: F32) -> dict[str, float]:
        camera = Camera(self._settings.intrinsics, self.pose(frame), self._reader.manifest.near)
        truth, alpha = self._truth(frame, camera)
        before, _ = self._truth(max(frame - age, 0), camera)
        covered = covered_mask(alpha)
        moving = covered & (np.abs(truth - before).max(axis=2) > CHANGED)
        out = {"moving": float(moving.mean())}
        for name, picture in (("distorted", distorted), ("restored", restored)):
            out[f"psnr_covered_{name}_db"] = psnr(picture, truth, covered)
            out[f"psnr_moving_{name}_db"] = psnr(picture, truth, moving) if moving.any() else math.nan
        return out

    def _truth(self, frame: int, camera: Camera, footprint: Footprint | None = None) -> tuple[F32, F32]:
        scene = raster.create("auto").load(self._reader.source(frame).splats)
        view = scene.render(camera, RenderOptions(footprint=footprint or Footprint()))
        return view.rgb.clip(0, 1), view.alpha

    def _send(self, pipe: ClientPipeline, frame: int, lod: int) -> None:
        for entry in self._reader.frame(frame).tiles:
            levels = min(lod + 1, len(entry.lod_bytes))
            parts = [self._reader.payload(frame, entry.tile, i) for i in range(levels)]
            message = TileLayers(frame, entry.tile, 0, levels, tuple(map(len, parts)), entry.crcs[:levels])
            pipe.on_tiles([(message, memoryview(b"".join(parts)))])
        pipe.on_frame_end(FrameEnd(frame), memoryview(self._reader.removed_payload(frame)))

    def _reference(self, frame: int, error_deg: float) -> tuple[ReferenceFrame, memoryview]:
        m = self._reader.manifest
        pose = moved(self.pose(frame), math.radians(error_deg), 0.02 * error_deg * m.focus_radius, *self._off)
        footprint = Footprint.of(self._settings.intrinsics, self._view)
        rgb, _ = self._truth(frame, Camera(self._view, pose, m.near), footprint)
        encoder = H264Encoder(self._view.width_px, self._view.height_px, m.fps, crf=self._crf, chroma=Chroma.FULL)
        unit = encoder.encode(rgb, idr=True)
        decoded = H264Decoder().decode(unit)
        assert decoded is not None, "the first picture of a video is an IDR picture"
        noise = coding_noise(rgb, decoded).packed()
        return ReferenceFrame(frame, frame + 1, pose, self._view, True, noise), memoryview(unit)


def gains(records: Sequence[dict[str, Any]], kind: str = "covered") -> tuple[float, float]:
    """Mean and least gain of the restored picture, dB."""
    found = [r[f"psnr_{kind}_restored_db"] - r[f"psnr_{kind}_distorted_db"] for r in records]
    known = [g for g in found if math.isfinite(g)]
    return (statistics.mean(known), min(known)) if known else (math.nan, math.nan)


def measure_ages(settings: AlignBenchSettings) -> Iterator[dict[str, Any]]:
    """One line for every age, way of coming and LoD, then a summary. Raises :class:`CagsError`."""
    ages, (width, height) = settings.age_list, settings.size_list[0]
    bundle = cached_bundle(settings.scene, settings.cache, EncodeSettings(frames=2 * max(ages) + 2))
    records = []
    with BundleReader.open(str(bundle)) as reader:
        frames = [reader.manifest.frames - 1 - max(ages), reader.manifest.frames - 1]
        client = ClientSettings(width=width, height=height, threads=settings.threads, reference_age=2 * max(ages))
        play = AgedPlay(reader, client, crf=settings.crf, seed=settings.seed)
        top = reader.manifest.lods - 1
        for age in ages:
            for coming in COMINGS:
                for lod in sorted({round(share * top) for share in LOD_SHARES}):
                    found = list(play.play(AgeCase(coming, age, lod, ERROR_DEG), frames))
                    figures = {kind: gains(found, kind) for kind in ("covered", "moving")}
                    records.append(figures)
                    names = {
                        f"gain_{k}_{n}_db": v for k, both in figures.items() for n, v in zip(STATS, both, strict=True)
                    }
                    yield {"benchmark": "align", "coming": coming, "age": age, "lod": lod, **names, **provenance()}
    least, mean = min(r["covered"][1] for r in records), statistics.mean(r["covered"][0] for r in records)
    checks = [
        check("least gain with references of another frame, dB", ">= -0.1", least, least >= -0.1),
        check("mean gain with references of another frame, dB", "> 0", mean, mean > 0),
    ]
    yield summary("align", checks, size=f"{width}x{height}")
