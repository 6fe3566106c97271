"""One method on one scene over one link: the unit of work that is computed once and kept."""

from __future__ import annotations

import functools
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from cags_bench.bundles import cached_bundle, default_cache, looped
from cags_bench.film.film import FilmMaker
from cags_bench.film.metrics import measure
from cags_bench.jsonl import JsonObject
from cags_bench.reproduce import added
from cags_bench.reproduce.cache import ResultCache, code_digest, content_of
from cags_bench.reproduce.methods import METHODS
from cags_bench.reproduce.pictures import Snapshot
from cags_bench.sim.session import Scenario, simulate, watched_by
from cags_bench.traces import PAPER_SPLATS, link_share, paper_link, scaled_trace
from cags_client.settings import ClientSettings
from cags_common.bundle import BundleReader
from cags_encoder import EncodeSettings, content_key
from cags_encoder.scenes import open_scene
from cags_server.settings import ServerSettings

WORDS = ("title", "note")
"""Parts of a method that are words: no result depends on them."""

SERIES = (
    "frame",
    "psnr_restored_db",
    "psnr_distorted_db",
    "ssim_restored",
    "lod_mean",
    "bytes_tiles",
    "aligned_share",
    "reference_kind",
)
"""What is kept of every frame."""


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
    lpips: str = ""
    """Weights file of LPIPS; empty: not measured."""
    video: tuple[str, ...] = ()
    """Metrics of the whole film that are measured."""

    @property
    def encoding(self) -> EncodeSettings:
        """How the method wants the scene encoded."""
        return replace(EncodeSettings(frames=self.frames), **METHODS[self.method].encode)

    def key(self, device: str) -> JsonObject:
        """What the result depends on, files by their content."""
        return {
            "case": asdict(self)
            | {"scene": _content_key(self.scene, self.encoding)}
            | {name: content_of(getattr(self, name)) for name in ("poses", "trace", "lpips")},
            "method": {name: value for name, value in asdict(METHODS[self.method]).items() if name not in WORDS},
            "added": added.digest(self.method),
            "device": device,
        }


@functools.cache
def _content_key(scene: str, settings: EncodeSettings) -> str:
    return content_key(scene, settings)


@dataclass
class Runner:
    """Runs cases, remembering results and bundles."""

    results: ResultCache
    bundles: str = ""
    """Folder of encoded bundles; empty: a folder of this very code's in the user's cache."""
    device: str = "auto"
    threads: int = 2
    """Threads of one case; results do not depend on it."""
    progress: bool = True
    """Whether encoding shows a bar."""

    def done(self, case: StreamCase) -> bool:
        """Whether the result of ``case`` is there."""
        return self.results.holds(case.key(self.device))

    def cpu_s(self, case: StreamCase) -> float:
        """Processor seconds that the kept result of ``case`` took."""
        return self.results.cpu_s(case.key(self.device))

    def run(self, case: StreamCase) -> JsonObject:
        """Summary, per-frame series and a picture of one case."""
        return self.results.get(case.key(self.device), lambda: self.compute(case))

    def bundle(self, case: StreamCase) -> Path:
        """The scene, encoded as the method wants it."""
        folder = self.bundles or str(default_cache() / f"code-{code_digest()}")
        return cached_bundle(case.scene, folder, case.encoding, progress=self.progress)

    def compute(self, case: StreamCase) -> JsonObject:
        """:meth:`run` without looking for an earlier result."""
        method = METHODS[case.method]
        bundle = self.bundle(case)
        with BundleReader.open(str(bundle)) as reader:
            fps, top_lod = reader.manifest.fps, reader.manifest.lods - 1
        server = ServerSettings(rasteriser=self.device, render_threads=self.threads)
        client = ClientSettings(width=case.width, height=case.height, raster=self.device, threads=self.threads)
        scenario = Scenario(
            bundle,
            self.link(case, bundle),
            case.poses,
            server=replace(server, **method.server),
            client=replace(client, **method.client),
            estimator="oracle",
            lpips=case.lpips,
        )
        truth = scenario.truth()
        snapshot = Snapshot(truth, frame=2 * case.frames // 3)
        with FilmMaker(truth, fps) as maker:
            watchers = [snapshot.watch, *([maker.watch] if case.video else [])]
            result = simulate(scenario, watched_by(watchers), truth)
            scores = measure(maker.film(case.frames), case.video) if case.video else {}
        frames = [{key: line.get(key) for key in SERIES} for line in result.frames]
        summary = result.summary | scores | {"top_lod": top_lod}
        summary["goodput_mbps"] /= self._faster(case)
        return {"summary": summary, "frames": frames, "pictures": snapshot.pictures}

    def link(self, case: StreamCase, bundle: Path) -> str:
        """The trace, scaled so that the scene gets the bits a splat and second that the paper's scenes get."""
        faster = self._faster(case)
        if case.mbps is not None:
            return paper_link(bundle, case.mbps * faster)
        share = link_share(bundle, PAPER_SPLATS) * faster
        return str(scaled_trace(case.trace, share, seconds=case.frames / 30 + 30))

    def _faster(self, case: StreamCase) -> float:
        """How many times the link is faster than for other methods."""
        return _saving(case.scene, case.frames) if METHODS[case.method].predicted else 1.0


@functools.cache
def _saving(scene: str, frames: int) -> float:
    from cags_research.codecs.encoding.inter import saving  # here: one method needs it

    return saving(looped(open_scene(scene), frames))


def averaged(results: list[JsonObject], key: str) -> float:
    """Mean of a summary figure over results; NaN where none has it."""
    values: list[Any] = [r["summary"].get(key) for r in results]
    known = [float(v) for v in values if v is not None]
    return sum(known) / len(known) if known else float("nan")
