"""A case of the experiment: one scene, one link, one viewer."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np

from cags_bench.bundles import cached_bundle
from cags_bench.jsonl import JsonObject
from cags_bench.references.settings import ReferenceBenchSettings
from cags_bench.traces import paper_link
from cags_encoder import EncodeSettings

LOSSES_DB = (0.1, 0.5)
"""Losses against the client's own splats; frames with a larger loss are counted."""

Frames = Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class Case:
    """A complete play except for the method."""

    scene: str
    link_mbps: float
    poses: str
    frames: int
    width: int
    height: int
    cache: str = ""

    @property
    def label(self) -> JsonObject:
        """Identifies equal cases of different runs, independent of folders."""
        return {
            "scene": _short(self.scene),
            "link_mbps": self.link_mbps,
            "poses": _short(self.poses),
            "frames": self.frames,
            "size": f"{self.width}x{self.height}",
        }

    @property
    def encoding(self) -> EncodeSettings:
        """Settings to encode the scene, as in ``cags-bench stream``."""
        return EncodeSettings(frames=self.frames)

    def bundle(self) -> Path:
        """The encoded scene."""
        return cached_bundle(self.scene, self.cache, self.encoding)

    def trace(self) -> str:
        """The trace of the link, scaled to this scene."""
        return paper_link(self.bundle(), self.link_mbps)


def cases_of(settings: ReferenceBenchSettings) -> Iterator[Case]:
    """Every scene over every link, each scene with its own walk or with all walks."""
    walks, (frames, width, height) = settings.walk_list, settings.size
    for scene, own in zip(settings.scene_list, cycle(walks), strict=False):
        for walk in walks if settings.full else [own]:
            for link in settings.link_list:
                yield Case(scene, link, walk, frames, width, height, settings.cache)


def figures_of(frames: Frames, summary: Mapping[str, Any]) -> JsonObject:
    """Quality and bytes of a play, from its records and summary. PSNR in dB over covered pixels."""
    shown = _series(frames, "psnr_covered_restored_db")
    own = _series(frames, "psnr_covered_distorted_db")
    losses = [mine - other for mine, other in zip(own, shown, strict=True) if math.isfinite(mine - other)]
    known = [value for value in shown if math.isfinite(value)]
    count = max(len(frames), 1)
    return {
        "psnr_db": float(np.mean(known)) if known else math.nan,
        "psnr_p5_db": float(np.percentile(known, 5)) if known else math.nan,
        "own_psnr_db": _mean(own),
        "psnr_whole_db": summary.get("psnr_restored_db"),
        "ssim": summary.get("ssim_restored"),
        "lpips": summary.get("lpips_restored"),
        "flicker": summary.get("flicker_restored"),
        "own_flicker": summary.get("flicker_distorted"),
        "worst_loss_db": max(losses, default=math.nan),
        **{
            f"worse_{limit:g}_db_share": sum(loss > limit for loss in losses) / max(len(losses), 1)
            for limit in LOSSES_DB
        },
        "reference_bytes": summary["bytes_reference"],
        "tile_bytes": summary["bytes_tiles"],
        "reference_bytes_a_frame": summary["bytes_reference"] / count,
        "frames_missed": summary["frames_missed"],
        "first_frame_ms": summary.get("first_frame_ms"),
        "prediction_error_deg": summary.get("prediction_error_deg"),
        "kinds": _kinds(frames),
    }


def _kinds(frames: Frames) -> JsonObject:
    """Share of the frames shown with each kind of reference; unknown in older records."""
    kinds = [str(frame.get("reference_kind", "unknown")) for frame in frames]
    return {kind or "no reference": kinds.count(kind) / len(kinds) for kind in sorted(set(kinds))}


def _series(frames: Frames, key: str) -> list[float]:
    return [math.nan if frame.get(key) is None else float(frame[key]) for frame in frames]


def _mean(values: Sequence[float]) -> float:
    known = [value for value in values if math.isfinite(value)]
    return float(np.mean(known)) if known else math.nan


def _short(spec: str) -> str:
    """``spec`` without the folders of its files."""
    return ":".join(Path(part).name if "/" in part else part for part in spec.split(":"))
