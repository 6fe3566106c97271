"""One play of ``cags-bench stream``: simulated, scored, and written to files if requested."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from cags_bench.bundles import cached_bundle
from cags_bench.film.film import Film, FilmMaker
from cags_bench.film.metrics import lacking, measure
from cags_bench.jsonl import dump
from cags_bench.sim.bundle import is_bundle, open_bundle
from cags_bench.sim.session import Scenario, SessionResult, Watcher, simulate, watched_by
from cags_bench.sim.truth import LastTruth
from cags_bench.stream.settings import DEFAULT_FRAMES, NO_FIGURE, StreamSettings
from cags_bench.stream.stages import StageSaver
from cags_bench.stream_report import STAGES_EVERY
from cags_bench.traces import scaled_trace
from cags_client.frame import restore
from cags_client.frame.presented import PresentedFrame
from cags_common.errors import ConfigError
from cags_encoder import EncodeSettings
from cags_server.fov import create_fov_policy
from cags_server.predict import create_predictor
from cags_server.ratecontrol import create_rate_policy
from cags_shaper.trace import open_trace


@dataclass(frozen=True)
class Play:
    """One play: its settings, its seed, and a label that distinguishes it from others of the run."""

    settings: StreamSettings
    seed: int = 0
    label: str = ""
    """Short label for files and rows; empty if there is only one play."""

    def check(self) -> None:
        """Raise :class:`ConfigError` for unknown names before a scene is encoded."""
        server, client = self.settings.server, self.settings.client
        create_rate_policy(server.abr)
        create_predictor(server.predictor)
        create_fov_policy(server.fov)
        restore.check_name(client.restore)
        open_trace(self.settings.trace)

    def line(self) -> dict[str, Any]:
        """Play, write the requested files, and return the figures. Raises :class:`CagsError`."""
        scenario, settings = self.scenario(), self.settings
        truth = scenario.truth()
        wanted = [metric for metric in settings.metrics if metric not in lacking(settings.metrics)]
        with ExitStack() as stack:
            watchers: list[Watcher] = []
            maker, end = None, 0
            if wanted or settings.record or settings.strip is not None:
                fps, end = rate_and_end(scenario)
                maker = stack.enter_context(FilmMaker(truth, fps))
                watchers.append(maker.watch)
            if settings.out:
                watchers.append(stack.enter_context(self._stages(truth)))
            result = simulate(scenario, watched_by(watchers), truth)
            line = dict(result.summary)
            if maker is not None:
                film = maker.film(end)
                line |= measure(film, wanted)
                self._write_film(film, result)
        if settings.out:
            write_report(self._beside(Path(settings.out)), scenario, result)
        played_settings = {key: value for key, value in asdict(settings).items() if key not in NO_FIGURE}
        return line | {"settings": played_settings, "seed": self.seed, "left_out": lacking(settings.metrics)}

    def scenario(self) -> Scenario:
        """The scenario of the settings. Encodes the scene if it is not in the cache."""
        settings = self.settings
        bundle, duration = self._bundle()
        return Scenario(
            bundle=bundle,
            trace=self._trace(),
            poses=settings.poses,
            server=settings.server,
            client=replace(settings.client, duration=duration),
            estimator=settings.estimator,
            delay_us=round(settings.delay_ms * 1000),
            queue_bytes=settings.queue_bytes,
            draw_us=round(settings.draw_ms * 1000),
            lpips=settings.lpips,
            seed=self.seed,
        )

    def _trace(self) -> str:
        """The trace, with its rates scaled by the share."""
        trace, share = self.settings.trace, self.settings.share
        if share == 1.0:
            return trace
        return str(scaled_trace(trace, share, seconds=open_trace(trace).duration_us / 1e6))

    def _bundle(self) -> tuple[Path, float | None]:
        """The bundle, and the length to play in seconds; None: all of it."""
        settings = self.settings
        if not is_bundle(settings.scene):
            encode = EncodeSettings(frames=settings.frames or DEFAULT_FRAMES)
            if settings.quantiser:
                encode = replace(encode, quantiser=settings.quantiser)
            return cached_bundle(settings.scene, settings.cache, encode), None
        if settings.quantiser:
            raise ConfigError(f"quantiser = {settings.quantiser!r}: {settings.scene} is encoded already; leave it out")
        bundle = Path(settings.scene)
        with open_bundle(bundle) as reader:
            count, fps = reader.manifest.frames, reader.manifest.fps
        if settings.frames > count:
            raise ConfigError(f"frames = {settings.frames}: {settings.scene} has {count}; give fewer")
        return bundle, settings.frames / fps if settings.frames else None

    @contextmanager
    def _stages(self, truth: LastTruth) -> Iterator[Watcher]:
        folder = self._beside(Path(self.settings.out))
        folder.mkdir(parents=True, exist_ok=True)
        with StageSaver(folder / "stages", STAGES_EVERY, truth) as saver:

            def watch(presented: PresentedFrame, record: dict[str, Any]) -> None:
                saver.save(presented)

            yield watch

    def _write_film(self, film: Film, result: SessionResult) -> None:
        from cags_bench.film.writing import write_clip, write_strip

        settings = self.settings
        if settings.record:
            write_clip(film, self._beside(Path(settings.record)), beside_truth=settings.record_truth)
        if settings.strip is not None:
            shown = {record["frame"]: record.get("psnr_restored_db") for record in result.frames}
            path = self._beside(Path(settings.out)) / "film-strip.png"
            write_strip(film, settings.strip, [shown.get(frame) for frame in film.frames], path)

    def _beside(self, path: Path) -> Path:
        """``path``, or a path for this play if there are several."""
        if not self.label:
            return path
        return path / self.label if path.suffix != ".mp4" else path.with_stem(f"{path.stem}-{self.label}")


def rate_and_end(scenario: Scenario) -> tuple[float, int]:
    """Frame rate of the scenario's bundle, and the media frame before which the play ends."""
    with open_bundle(scenario.bundle) as reader:
        count, fps = reader.manifest.frames, reader.manifest.fps
    client = scenario.client
    end = count if client.duration is None else client.start_frame + round(client.duration * fps)
    return fps, min(count, end)


def write_report(out: Path, scenario: Scenario, result: SessionResult) -> None:
    """Write frames, a plot over time and a strip of pictures."""
    from cags_bench.stream_report import capacity_series, plot_stream, telling_frame, write_strip

    (out / "frames.jsonl").write_text("".join(dump(line) + "\n" for line in result.frames), encoding="utf-8")
    times_us = [line["time_us"] for line in result.frames]
    seconds = max((times_us[-1] - times_us[0]) / 1e6, 0.1)
    plot_stream(result.frames, capacity_series(scenario.link(), seconds), out / "timeline.png")
    chosen = telling_frame(result.frames)
    if chosen is not None:
        write_strip(out / "stages", chosen, out / "strip.png")
