"""The experiment behind ``cags-bench stream``."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from cags_bench.bundles import cached_bundle
from cags_bench.jsonl import dump, provenance
from cags_bench.sim.session import Scenario, SessionResult, simulate
from cags_bench.stream.settings import StreamSettings
from cags_bench.stream_report import STAGES_EVERY
from cags_client.frame.presented import PresentedFrame
from cags_client.settings import ClientSettings
from cags_encoder import EncodeSettings
from cags_server.settings import ServerSettings


def stream(settings: StreamSettings) -> dict[str, Any]:
    """Encode (or reuse), simulate, and return the summary line; the report goes to ``settings.out``, if given."""
    scenario = scenario_of(settings)
    if not settings.out:
        result = simulate(scenario)
    else:
        from cags_bench.stream.stages import StageSaver

        out = Path(settings.out)
        out.mkdir(parents=True, exist_ok=True)
        with StageSaver(out / "stages", STAGES_EVERY, scenario) as saver:

            def watch(presented: PresentedFrame, record: dict[str, Any]) -> None:
                saver.save(presented)

            result = simulate(scenario, watch)
        write_report(out, settings, result)
    shown = {key: value for key, value in asdict(settings).items() if key not in ("cache", "out")}
    return {**result.summary, "benchmark": "stream", "settings": shown, **provenance()}


def scenario_of(settings: StreamSettings) -> Scenario:
    """The scenario that flat settings describe; encodes the scene if it has not been."""
    encode = EncodeSettings(frames=settings.frames)
    if settings.quantiser:
        encode = replace(encode, quantiser=settings.quantiser)
    return Scenario(
        bundle=cached_bundle(settings.scene, settings.cache, encode),
        trace=settings.trace,
        poses=settings.poses,
        server=ServerSettings(
            predictor=settings.predictor,
            fov=settings.fov_policy,
            abr=settings.abr,
            references=settings.references,
            reference_footprint=settings.reference_footprint,
        ),
        client=ClientSettings(
            width=settings.width,
            height=settings.height,
            fov=settings.fov,
            restore=settings.restore,
            erosion=settings.erosion,
        ),
        estimator=settings.estimator,
        delay_us=round(settings.delay_ms * 1000),
        queue_bytes=settings.queue_bytes,
    )


def write_report(out: Path, settings: StreamSettings, result: SessionResult) -> None:
    """Frames, plot over time and a strip of pictures."""
    from cags_bench.stream_report import capacity_series, plot_stream, telling_frame, write_strip
    from cags_shaper.trace import open_trace

    (out / "frames.jsonl").write_text("".join(dump(line) + "\n" for line in result.frames), encoding="utf-8")
    times_us = [line["time_us"] for line in result.frames]
    seconds = max((times_us[-1] - times_us[0]) / 1e6, 0.1)
    plot_stream(result.frames, capacity_series(open_trace(settings.trace), seconds), out / "timeline.png")
    chosen = telling_frame(result.frames)
    if chosen is not None:
        write_strip(out / "stages", chosen, out / "strip.png")
