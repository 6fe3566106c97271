"""One play of ``cags-bench stream``: simulated, scored, and written to files if requested."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from cags_bench.bundles import cached_bundle, frames_of
from cags_bench.film.film import Film, FilmMaker
from cags_bench.film.metrics import lacking, measure
from cags_bench.inputs import check_traces, check_walks
from cags_bench.jsonl import dump
from cags_bench.outputs import check_output_file
from cags_bench.sim.bundle import is_bundle, open_bundle
from cags_bench.sim.session import Scenario, SessionResult, Watcher, simulate, watched_by
from cags_bench.sim.truth import LastTruth
from cags_bench.stream.settings import DEFAULT_FRAMES, NO_FIGURE, StreamSettings
from cags_bench.stream.stages import StageSaver
from cags_bench.stream_report import STAGES_EVERY
from cags_bench.traces import scaled_trace
from cags_client.frame import align, restore
from cags_client.frame.presented import PresentedFrame
from cags_common import raster
from cags_common.errors import ConfigError
from cags_common.files import writable_folder
from cags_common.lpips import SMALLEST_SIDE_PX, Lpips
from cags_encoder import EncodeSettings
from cags_server.session.policies import check_choices
from cags_shaper.trace import open_trace

STRIP, FILM_STRIP = "strip.png", "film-strip.png"
PICTURES = STRIP, FILM_STRIP
"""Pictures of a report that not every play has."""


@dataclass(frozen=True)
class Play:
    """One play: its settings, its seed, and a label that distinguishes it from others of the run."""

    settings: StreamSettings
    seed: int = 0
    label: str = ""
    """Short label for files and rows; empty if there is only one play."""

    def check(self) -> None:
        """Refuse what cannot be played before a scene is encoded: all but the outputs, which differ from play to play.

        Raises :class:`CagsError`.
        """
        settings, server, client = self.settings, self.settings.server, self.settings.client
        check_choices(server)
        restore.check_name(client.restore)
        align.create(client.align)
        for rasteriser in (server.rasteriser, client.raster):
            raster.create(rasteriser)
        check_traces([settings.trace])
        check_walks([settings.poses])
        if settings.lpips:
            Lpips(settings.lpips)
            if min(client.width, client.height) < SMALLEST_SIDE_PX:
                raise ConfigError(
                    f"lpips = {settings.lpips!r}: pictures of {client.width}x{client.height} are too small for it; "
                    f"give --width and --height of {SMALLEST_SIDE_PX} or more"
                )
        frames = self._frames()
        if settings.strip is not None:
            from cags_bench.film.writing import check_strip

            check_strip(range(client.start_frame, frames), settings.strip)

    def check_outputs(self) -> None:
        """Refuse files and folders that cannot be written; make the report's folder. Raises :class:`CagsError`."""
        if self.settings.record:
            check_output_file("record", self.settings.record, self._beside(Path(self.settings.record)))
        if self.settings.out:
            writable_folder(self._beside(Path(self.settings.out)))

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
            return cached_bundle(settings.scene, settings.cache, self._encoding()), None
        bundle = Path(settings.scene)
        with open_bundle(bundle) as reader:
            fps = reader.manifest.fps
        return bundle, settings.frames / fps if settings.frames else None

    def _encoding(self) -> EncodeSettings:
        """How a scene is encoded."""
        settings = self.settings
        encode = EncodeSettings(frames=settings.frames or frames_of(settings.scene, DEFAULT_FRAMES))
        return replace(encode, quantiser=settings.quantiser) if settings.quantiser else encode

    def _frames(self) -> int:
        """The media frame before which the play ends. Raises :class:`CagsError` for what the scene cannot give."""
        settings = self.settings
        if not is_bundle(settings.scene):
            return self._encoding().frames or 0
        if settings.quantiser:
            raise ConfigError(f"quantiser = {settings.quantiser!r}: {settings.scene} is encoded already; leave it out")
        with open_bundle(Path(settings.scene)) as reader:
            count = reader.manifest.frames
        if settings.frames > count:
            raise ConfigError(f"frames = {settings.frames}: {settings.scene} has {count}; give fewer")
        return min(count, settings.client.start_frame + settings.frames) if settings.frames else count

    @contextmanager
    def _stages(self, truth: LastTruth) -> Iterator[Watcher]:
        folder = self._beside(Path(self.settings.out))
        folder.mkdir(parents=True, exist_ok=True)
        for name in PICTURES:
            (folder / name).unlink(missing_ok=True)  # of an earlier play
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
            path = self._beside(Path(settings.out)) / FILM_STRIP
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
    from cags_bench.stream_report import plot_stream, telling_frame, write_strip

    (out / "frames.jsonl").write_text("".join(dump(line) + "\n" for line in result.frames), encoding="utf-8")
    waited_s = result.frames[0]["time_us"] / 1e6 if result.frames else 0.0  # the link begins at 0
    plot_stream(result.frames, out / "timeline.png", waited_s=waited_s, link=scenario.link())
    chosen = telling_frame(result.frames)
    if chosen is not None:
        write_strip(out / "stages", chosen, out / STRIP)
