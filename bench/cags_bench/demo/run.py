"""Runs the demo: three processes on free local ports, then a report."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any

from cags_bench.bundles import cached_bundle, frames_of
from cags_bench.demo.processes import Process, ProcessGroup
from cags_bench.demo.settings import DemoSettings
from cags_bench.doctor.machine import usable_cores
from cags_bench.inputs import check_walks
from cags_bench.jsonl import provenance
from cags_bench.sim.bundle import SOURCE, is_bundle, truth_of
from cags_bench.stream_report import (
    STAGES_EVERY,
    gain_db,
    plot_stream,
    read_lines,
    telling_frame,
    write_strip,
)
from cags_bench.traces import scaled_trace
from cags_common.errors import CagsError, ConfigError, NetworkError, OutputError
from cags_common.files import writable_folder
from cags_encoder import EncodeSettings
from cags_shaper.trace import open_trace

DEFAULT_FRAMES = 90
TRACE_S = 60.0
"""Length of the scaled trace, which repeats."""

CLIENT_GRACE_S, SCORING_S = 240.0, 2.5
"""Longest times that the client takes beside its play: to start, to join and to end, and to score each frame."""

SCRATCH = ".cags-demo-"
"""Beginning of the name of the folder in which a report is made."""


def threads_each(settings: DemoSettings) -> str:
    """Threads per render in server and client: by default all cores for both, which rarely draw at the same time."""
    return str(settings.threads or usable_cores())


@dataclass(frozen=True)
class DemoSize:
    """What a machine can show in real time: picture size, and the spec of the built-in scene."""

    width_px: int
    height_px: int
    scene: str


NATIVE = DemoSize(640, 480, "procedural:size=30000,frames=90")
READABLE = DemoSize(320, 240, "procedural:size=3000,frames=90")
"""Without the native kernels the float64 reference renders, which is correct but a hundred times slower."""


def run_demo(scene: str, settings: DemoSettings, progress: IO[str]) -> dict[str, Any]:
    """Run the demo, write its report to ``settings.out``, and return the summary.

    Raises :class:`CagsError` if a part cannot run; the output folder is then unchanged.
    """
    size = machine_size(progress)
    width, height = settings.width or size.width_px, settings.height or size.height_px
    out = Path(os.path.realpath(settings.out))  # a symbolic link stays one
    check_replaceable(out)
    beside = writable_folder(out if out.exists() else out.parent)
    bundle = demo_bundle(scene, size, settings)
    held, fps = clip_length(bundle)
    frames = settings.frames or held
    if frames > held:  # only a bundle: scenes are encoded at the length asked for
        raise ConfigError(f"frames = {frames}: {scene} has {held}; give fewer")
    with tempfile.TemporaryDirectory(prefix=SCRATCH, dir=beside) as scratch:
        report = Path(scratch) / "report"
        report.mkdir()
        sized = replace(settings, width=width, height=height)
        limit_s, duration_s = client_limit_s(frames, fps), frames / fps if frames < held else None
        client = stream_once(str(bundle), sized, report, progress, limit_s=limit_s, duration_s=duration_s)
        summary = write_report(report, settings, frames)
        summary["client_exit_code"] = client
        replace_report(report, out)
    return summary


def check_link_and_walk(settings: DemoSettings) -> None:
    """Report unreadable traces and walks before a scene is encoded. Raises :class:`CagsError`."""
    open_trace(settings.trace)
    check_walks([settings.poses])


def demo_bundle(scene: str, size: DemoSize, settings: DemoSettings) -> Path:
    """The encoded scene, from the cache if possible; a bundle as it is. The built-in scene has the size that suits the
    machine.

    Raises :class:`CagsError` for a scene that cannot be read, and for a published folder, which has nothing to compare
    with.
    """
    check_link_and_walk(settings)
    if is_bundle(scene):
        if truth_of(Path(scene)) != SOURCE:
            raise ConfigError(f"{scene}: is published, without the source frames; give the bundle that it was made of")
        return Path(scene)
    spec = size.scene if scene == "procedural" else scene
    frames = settings.frames or frames_of(spec, DEFAULT_FRAMES)
    return cached_bundle(spec, settings.cache, EncodeSettings(frames=frames))


def machine_size(progress: IO[str]) -> DemoSize:
    """The demo's size on this machine; prints a note if the kernels are missing."""
    from cags_kernels import native_available, why_unavailable

    if native_available():
        return NATIVE
    print(
        f"cags-demo: no native kernels ({why_unavailable()}); the demo runs at a small size with the slow reference",
        file=progress,
    )
    return READABLE


def show_live(scene: str, settings: DemoSettings, progress: IO[str]) -> None:
    """Run the three processes with the client's live page, and print its address. Returns when interrupted.

    Raises :class:`CagsError` if a part cannot run or ends by itself.
    """
    if settings.frames and is_bundle(scene):
        raise ConfigError(f"frames = {settings.frames}: --view plays all of the bundle {scene}; leave it out")
    size = machine_size(progress)
    width, height = settings.width or size.width_px, settings.height or size.height_px
    bundle = demo_bundle(scene, size, settings)
    with tempfile.TemporaryDirectory(prefix="cags-demo-") as logs, ProcessGroup(Path(logs)) as group:
        shaper = start_link(group, str(bundle), settings, "--control", "127.0.0.1:0")
        client = group.start(
            "cags_client",
            [
                *("--url", f"ws://127.0.0.1:{shaper['port']}/stream", "--view", "--view-port", "0", "--json", "-"),
                *("--shaper-control", f"127.0.0.1:{shaper['control']}", "--poses", settings.poses),
                *("--width", str(width), "--height", str(height), "--truth", str(bundle)),
                *("--threads", threads_each(settings)),
                *("--exactness", "fast"),  # its error (70 dB) is far below that of the page's video coding
            ],
        )
        print(f"\n    the scene streams at  {client.ready()['url']}\n\n    Ctrl-C stops it\n", flush=True)
        client.handle.wait()
        raise NetworkError(f"{client.name} ended: {client.last_words()}")


def stream_once(
    bundle: str, settings: DemoSettings, report: Path, progress: IO[str], *, limit_s: float, duration_s: float | None
) -> int:
    """Run server, shaper and client until the client has played ``duration_s``, or the clip; logs and frames are
    written to ``report``.

    Raises :class:`CagsError` if a part fails, or if the client has not ended after ``limit_s``.
    """
    with ProcessGroup(report) as group:
        shaper = start_link(group, bundle, settings)
        print(f"cags-demo: server and shaper are up (port {shaper['port']}), client starts", file=progress)
        client = group.start("cags_client", client_arguments(bundle, shaper["port"], settings, report, duration_s))
        return wait_for_client(client, limit_s)


def start_link(group: ProcessGroup, bundle: str, settings: DemoSettings, *more: str) -> dict[str, Any]:
    """Start server and shaper; return the shaper's ready line."""
    serve = ["--bundle", bundle, "--port", "0", "--json", "--render-threads", threads_each(settings)]
    server = group.start("cags_server", serve).ready()
    ends = ("--listen", "127.0.0.1:0", "--to", f"127.0.0.1:{server['port']}")
    rate = ("--trace", link_trace(settings), "--delay-ms", str(settings.delay_ms))
    return group.start("cags_shaper", [*ends, *rate, "--json", *more]).ready()


def link_trace(settings: DemoSettings) -> str:
    """The trace of the demo's link, with its rate scaled."""
    if settings.share == 1.0:
        return settings.trace
    return str(scaled_trace(settings.trace, settings.share, TRACE_S))


def client_arguments(
    bundle: str, port: int, settings: DemoSettings, report: Path, duration_s: float | None = None
) -> list[str]:
    """The client's command line."""
    stages = report / "stages"
    return [
        *("--url", f"ws://127.0.0.1:{port}/stream", "--poses", settings.poses, "--truth", bundle),
        *("--json", str(report / "frames.jsonl"), "--stages", str(stages), "--stages-every", str(STAGES_EVERY)),
        *("--width", str(settings.width), "--height", str(settings.height), "--threads", threads_each(settings)),
        *(() if duration_s is None else ("--duration", str(duration_s))),
    ]


def client_limit_s(frames: int, fps: float) -> float:
    """Longest time that the client may take for a clip: to play it and to score it."""
    return CLIENT_GRACE_S + frames / fps + frames * SCORING_S


def wait_for_client(client: Process, limit_s: float) -> int:
    """Wait until the client ends. Raises :class:`NetworkError` with its last message if it fails, or takes longer."""
    try:
        output, _ = client.handle.communicate(timeout=limit_s)
    except subprocess.TimeoutExpired:
        raise NetworkError(
            f"{client.name} did not end within {limit_s:.0f} s; give fewer --frames or a smaller --width and --height"
        ) from None
    if client.handle.returncode != 0:
        raise NetworkError(f"{client.name} failed: {client.last_words()}")
    if output:
        (client.log.parent / "client.out").write_text(output, encoding="utf-8")
    return client.handle.returncode


def clip_length(bundle: Path) -> tuple[int, float]:
    """Number of media frames in the play, and frames per second."""
    from cags_common.bundle import BundleReader

    with BundleReader.open(str(bundle)) as reader:
        return reader.manifest.frames, reader.manifest.fps


def write_report(report: Path, settings: DemoSettings, clip_frames: int) -> dict[str, Any]:
    """Write plot, strip and summary of the finished session; return the summary."""
    from cags_shaper.trace import open_trace

    frames, summary = read_lines(report / "frames.jsonl")
    waited_s = (summary.get("first_frame_ms") or 0) / 1e3  # the link's time begins with the connection
    plot_stream(frames, report / "timeline.png", waited_s=waited_s, link=open_trace(link_trace(settings)))
    chosen = telling_frame(frames)
    strip: dict[str, Any] | None = None
    if chosen is not None and write_strip(report / "stages", chosen, report / "strip.png"):
        strip = {"frame": chosen, "gain_db": next(gain_db(frame) for frame in frames if frame["frame"] == chosen)}
    run = {"trace": settings.trace, "share": settings.share, "delay_ms": settings.delay_ms, "clip_frames": clip_frames}
    merged = {**summary, "benchmark": "demo", **run, "strip": strip, **provenance()}
    (report / "summary.json").write_text(json.dumps(merged, indent=2, sort_keys=True) + "\n", encoding="utf-8")
    return merged


def check_replaceable(out: Path) -> None:
    """Refuse to replace what is not an earlier report, nor an empty folder. Raises :class:`CagsError`."""
    if not out.exists() and not out.is_symlink():
        return
    if out.is_dir():
        names = {path.name for path in out.iterdir() if not path.name.startswith(SCRATCH)}
        if not names or "summary.json" in names:
            return
    raise CagsError(f"{out}: exists and is not an earlier report; name another folder with --out")


def replace_report(made: Path, out: Path) -> None:
    """Put the files of a finished report into the place of those of an earlier one, which are left beside ``made``.

    The folder ``out`` itself stays if there is one: it may be a mount, or the folder that somebody works in. Raises
    :class:`OutputError`, and leaves it as it was, if files cannot be moved.
    """
    if not out.exists():
        made.rename(out)
        return
    old = made.with_name("old")
    old.mkdir()
    away = [(path, old / path.name) for path in out.iterdir() if path not in made.parents]
    moves = [*away, *((path, out / path.name) for path in made.iterdir())]
    moved: list[tuple[Path, Path]] = []
    try:
        for source, target in moves:
            source.rename(target)
            moved.append((source, target))
    except OSError as error:
        for source, target in reversed(moved):
            target.rename(source)
        raise OutputError.of(out, error) from error
