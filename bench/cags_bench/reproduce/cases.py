"""One method on one scene over one link: the unit of work that is computed once and kept."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from cags_bench.bundles import cached_bundle
from cags_bench.jsonl import JsonObject
from cags_bench.reproduce.cache import ResultCache
from cags_bench.reproduce.methods import METHODS
from cags_bench.sim.session import Scenario, simulate
from cags_bench.traces import scaled_trace
from cags_client.settings import ClientSettings
from cags_common.bundle import BundleReader
from cags_encoder import EncodeSettings
from cags_server.settings import ServerSettings

PAPER_SPLATS = 170_000
"""Splats of the paper's first frames: 2.0 MB at 66 bits and about 28 bits of position each."""


@dataclass(frozen=True)
class StreamCase:
    """Everything that decides one streamed result. ``mbps`` is the paper's; the link gets the same bits a splat."""

    scene: str
    method: str
    poses: str
    frames: int
    width: int
    height: int
    trace: str
    mbps: float | None = None
    """A steady rate; None: the rates of ``trace``."""


@dataclass
class Runner:
    """Runs cases, remembering results and bundles."""

    results: ResultCache
    bundles: str = ""
    device: str = "auto"

    def run(self, case: StreamCase) -> JsonObject:
        """Summary and the per-frame series of one case."""
        return self.results.get({"case": asdict(case), "device": self.device}, lambda: self._simulate(case))

    def bundle(self, case: StreamCase) -> Path:
        """The scene, encoded as the method wants it."""
        settings = replace(EncodeSettings(frames=case.frames), **METHODS[case.method].encode)
        return cached_bundle(case.scene, self.bundles, settings)

    def _simulate(self, case: StreamCase) -> JsonObject:
        method = METHODS[case.method]
        bundle = self.bundle(case)
        server = replace(ServerSettings(rasteriser=self.device), **method.server)
        client = replace(ClientSettings(width=case.width, height=case.height, raster=self.device), **method.client)
        result = simulate(
            Scenario(bundle, self.link(case, bundle), case.poses, server=server, client=client, estimator="oracle")
        )
        keys = ("frame", "psnr_restored_db", "ssim_restored", "lod_mean", "bytes_tiles", "bytes_reference")
        frames = [{key: line.get(key) for key in keys} for line in result.frames]
        return {"summary": result.summary, "frames": frames}

    def link(self, case: StreamCase, bundle: Path) -> str:
        """The trace, scaled so that the scene gets the bits a splat and second that the paper's scenes get."""
        share = _splats(bundle) / PAPER_SPLATS
        if case.mbps is not None:
            return f"generated:steady-{max(case.mbps * share, 0.1):.3f}"
        return str(scaled_trace(case.trace, share, seconds=case.frames / 30 + 30))


def _splats(bundle: Path) -> int:
    reader = BundleReader.open(str(bundle))
    try:
        return sum(tile.splats for tile in reader.frame(0).tiles)
    finally:
        reader.close()


def averaged(results: list[JsonObject], key: str) -> float:
    """Mean of a summary figure over results; NaN where none has it."""
    values: list[Any] = [r["summary"].get(key) for r in results]
    known = [float(v) for v in values if v is not None]
    return sum(known) / len(known) if known else float("nan")
