"""Units of work that are computed once and kept: a method on a scene over a link, and what computes them."""

from __future__ import annotations

import functools
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from cags_bench.bundles import cached_bundle, default_cache, identified, looped
from cags_bench.film.film import FilmMaker
from cags_bench.film.metrics import measure
from cags_bench.jsonl import JsonObject
from cags_bench.reproduce import added
from cags_bench.reproduce.cache import ResultCache, code_digest, content_of
from cags_bench.reproduce.methods import METHODS
from cags_bench.reproduce.pictures import Snapshot
from cags_bench.sim.session import Scenario, simulate, watched_by
from cags_bench.traces import PAPER_SPLATS, link_share, paper_link, scaled_trace, steepest_fall_s
from cags_client.settings import ClientSettings
from cags_common.bundle import BundleReader
from cags_encoder import EncodeSettings, content_key
from cags_encoder.scenes import open_scene
from cags_server.settings import ServerSettings

WORDS = ("title", "note")
"""Parts of a method that are words: no result depends on them."""

START_S = 1.0
"""About how long the link is used before the first frame is displayed."""

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
class Encoding:
    """A bundle that a unit of work needs."""

    scene: str
    settings: EncodeSettings

    @property
    def clip(self) -> Clip:
        """What is encoded."""
        return self.scene, self.settings.frames


Clip = tuple[str, int | None]
"""A scene and its number of frames."""


class Work(Protocol):
    """A unit of work. It is hashable, and travels to other processes."""

    @property
    def encodings(self) -> tuple[Encoding, ...]:
        """Bundles that must be there before :meth:`compute` runs in several processes."""
        ...

    def key(self, device: str) -> JsonObject:
        """What the result depends on, files by their content."""
        ...

    def compute(self, runner: Runner) -> JsonObject:
        """The result."""
        ...

    def __str__(self) -> str:
        """The unit in words, for progress."""
        ...


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
    unscaled: bool = False
    """Whether the rates of ``trace`` stand as recorded."""
    lpips: str = ""
    """Weights file of LPIPS; empty: not measured."""
    video: tuple[str, ...] = ()
    """Metrics of the whole film that are measured."""

    @property
    def encoding(self) -> Encoding:
        """The scene, encoded as the method wants it."""
        return Encoding(self.scene, replace(EncodeSettings(frames=self.frames), **METHODS[self.method].encode))

    @property
    def encodings(self) -> tuple[Encoding, ...]:
        """See :class:`Work`."""
        return (self.encoding,)

    def __str__(self) -> str:
        link = "" if self.mbps is None else f", {self.mbps:g} Mbps"
        return f"{self.scene}, {self.method}{link}" + (", unscaled" if self.unscaled else "")

    def key(self, device: str) -> JsonObject:
        """What the result depends on, files by their content."""
        return {
            "case": asdict(self)
            | {"scene": scene_key(self.encoding)}
            | {name: content_of(getattr(self, name)) for name in ("poses", "trace", "lpips")},
            "method": {name: value for name, value in asdict(METHODS[self.method]).items() if name not in WORDS},
            "added": added.digest(self.method),
            "device": device,
        }

    def compute(self, runner: Runner) -> JsonObject:
        """Summary, per-frame series, a picture, and what both sides spent (the only part that differs between runs)."""
        method = METHODS[self.method]
        bundle = runner.bundle(self.encoding)
        with BundleReader.open(str(bundle)) as reader:
            fps, top_lod = reader.manifest.fps, reader.manifest.lods - 1
        server = ServerSettings(rasteriser=runner.device, render_threads=runner.threads)
        client = ClientSettings(width=self.width, height=self.height, raster=runner.device, threads=runner.threads)
        scenario = Scenario(
            bundle,
            self.link(bundle),
            self.poses,
            server=replace(server, **method.server),
            client=replace(client, **method.client),
            estimator="oracle",
            lpips=self.lpips,
        )
        truth = scenario.truth()
        snapshot = Snapshot(truth, frame=2 * self.frames // 3)
        with FilmMaker(truth, fps) as maker:
            watchers = [snapshot.watch, *([maker.watch] if self.video else [])]
            result = simulate(scenario, watched_by(watchers), truth)
            scores = measure(maker.film(self.frames), self.video) if self.video else {}
        frames = [{key: line.get(key) for key in SERIES} for line in result.frames]
        summary = result.summary | scores | {"top_lod": top_lod}
        summary["goodput_mbps"] /= self._faster
        spent = {"server_ms": result.spent.server_ms_a_frame, "client_ms": result.spent.client_ms_a_frame}
        return {"summary": summary, "frames": frames, "pictures": snapshot.pictures, "spent": spent}

    def link(self, bundle: Path) -> str:
        """The trace, scaled so that the scene gets the bits a splat and second that the paper's scenes get.

        Of a recorded trace the clip gets the part whose middle is the steepest fall.
        """
        if self.mbps is not None:
            return paper_link(bundle, self.mbps * self._faster)
        share = self._faster * (1.0 if self.unscaled else link_share(bundle, PAPER_SPLATS))
        seconds = self.frames / 30 + START_S
        return str(scaled_trace(self.trace, share, seconds + 30, steepest_fall_s(self.trace, seconds)))

    @property
    def _faster(self) -> float:
        """How many times the link is faster than for other methods."""
        return _saving(self.scene, self.frames) if METHODS[self.method].predicted else 1.0


@functools.cache
def scene_key(encoding: Encoding) -> str:
    """What a key says of an encoded scene."""
    return content_key(encoding.scene, encoding.settings)


@dataclass
class Runner:
    """Runs units of work, remembering results and bundles."""

    results: ResultCache
    bundles: str = ""
    """Folder of encoded bundles; empty: a folder of this very code's in the user's cache."""
    device: str = "auto"
    threads: int = 2
    """Threads of one unit; results do not depend on it."""
    progress: bool = True
    """Whether encoding shows a bar."""

    def done(self, work: Work) -> bool:
        """Whether the result of ``work`` is there."""
        return self.results.holds(work.key(self.device))

    def cpu_s(self, work: Work) -> float:
        """Processor seconds that the kept result of ``work`` took."""
        return self.results.cpu_s(work.key(self.device))

    def run(self, work: Work) -> JsonObject:
        """The result of ``work``."""
        return self.results.get(work.key(self.device), lambda: work.compute(self))

    def bundle(self, encoding: Encoding) -> Path:
        """The encoded scene."""
        scene, settings = encoding.scene, encoding.settings
        source = functools.partial(identified, scene, settings.frames, self._folder / "identities")
        return cached_bundle(scene, str(self._folder), settings, progress=self.progress, source=source)

    def link(self, clip: Clip) -> None:
        """Find the identities of a clip's splats, for all of its encodings."""
        identified(*clip, self._folder / "identities")

    @property
    def _folder(self) -> Path:
        return Path(self.bundles) if self.bundles else default_cache() / f"code-{code_digest()}"


@functools.cache
def _saving(scene: str, frames: int) -> float:
    from cags_research.codecs.encoding.inter import saving  # here: one method needs it

    return saving(looped(open_scene(scene), frames))


def averaged(results: list[JsonObject], key: str) -> float:
    """Mean of a summary figure over results; NaN where none has it."""
    values: list[Any] = [r["summary"].get(key) for r in results]
    known = [float(v) for v in values if v is not None]
    return sum(known) / len(known) if known else float("nan")
