"""Runs the demo: three processes on free local ports, then a report."""

from __future__ import annotations

import json
import shutil
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any

from cags_bench.bundles import cached_bundle
from cags_bench.demo.processes import Process, ProcessGroup
from cags_bench.demo.settings import DemoSettings
from cags_bench.doctor.machine import usable_cores
from cags_bench.jsonl import provenance
from cags_bench.stream_report import STAGES_EVERY, capacity_series, plot_stream, read_lines, telling_frame, write_strip
from cags_bench.traces import scaled_trace
from cags_common.errors import CagsError, NetworkError
from cags_common.poses import Focus, open_poses
from cags_encoder import EncodeSettings
from cags_shaper.trace import open_trace

DEFAULT_FRAMES = 90
TRACE_S = 60.0
"""Length of the scaled trace, which repeats."""

CLIENT_GRACE_S = 240.0
"""Time that the client has to score its frames after the last one was shown."""


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
READABLE = DemoSize(320, 240, "procedural:size=3000,frames=24")
"""Without the native kernels the float64 reference renders, which is correct but a hundred times slower."""


def run_demo(scene: str, settings: DemoSettings, progress: IO[str]) -> dict[str, Any]:
    """Run the demo, write its report to ``settings.out``, and return the summary.

    Raises :class:`CagsError` if a part cannot run; the output folder is then unchanged.
    """
    size = machine_size(progress)
    width, height = settings.width or size.width_px, settings.height or size.height_px
    out = Path(settings.out)
    check_replaceable(out)
    out.parent.mkdir(parents=True, exist_ok=True)
    bundle = demo_bundle(scene, size, settings)
    with tempfile.TemporaryDirectory(prefix=".cags-demo-", dir=out.parent) as scratch:
        report = Path(scratch) / "report"
        report.mkdir()
        client = stream_once(str(bundle), replace(settings, width=width, height=height), report, progress)
        summary = write_report(report, settings, clip_frames(bundle, settings))
        summary["client_exit_code"] = client
        replace_folder(report, out)
    return summary


def check_link_and_walk(settings: DemoSettings) -> None:
    """Report unreadable traces and walks before a scene is encoded. Raises :class:`CagsError`."""
    open_trace(settings.trace)
    open_poses(settings.poses, Focus((0.0, 0.0, 0.0), 1.0, (0.0, 1.0, 0.0)))


def demo_bundle(scene: str, size: DemoSize, settings: DemoSettings) -> Path:
    """The encoded scene, from the cache if possible; the built-in scene has the size that suits the machine."""
    check_link_and_walk(settings)
    spec = size.scene if scene == "procedural" else scene
    return cached_bundle(spec, settings.cache, EncodeSettings(frames=settings.frames or DEFAULT_FRAMES))


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


def stream_once(bundle: str, settings: DemoSettings, report: Path, progress: IO[str]) -> int:
    """Run server, shaper and client until the client ends; logs and frames are written to ``report``."""
    with ProcessGroup(report) as group:
        shaper = start_link(group, bundle, settings)
        print(f"cags-demo: server and shaper are up (port {shaper['port']}), client starts", file=progress)
        client = group.start("cags_client", client_arguments(bundle, shaper["port"], settings, report))
        return wait_for_client(client)


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


def client_arguments(bundle: str, port: int, settings: DemoSettings, report: Path) -> list[str]:
    """The client's command line."""
    stages = report / "stages"
    return [
        *("--url", f"ws://127.0.0.1:{port}/stream", "--poses", settings.poses, "--truth", bundle),
        *("--json", str(report / "frames.jsonl"), "--stages", str(stages), "--stages-every", str(STAGES_EVERY)),
        *("--width", str(settings.width), "--height", str(settings.height), "--threads", threads_each(settings)),
    ]


def wait_for_client(client: Process) -> int:
    """Wait until the client ends. Raises :class:`NetworkError` with its last message if it fails."""
    output, _ = client.handle.communicate(timeout=CLIENT_GRACE_S)
    if client.handle.returncode != 0:
        raise NetworkError(f"{client.name} failed: {client.last_words()}")
    if output:
        (client.log.parent / "client.out").write_text(output, encoding="utf-8")
    return client.handle.returncode


def clip_frames(bundle: Path, settings: DemoSettings) -> int:
    """Number of media frames in the play."""
    from cags_common.bundle import BundleReader

    with BundleReader.open(str(bundle)) as reader:
        return reader.manifest.frames


def write_report(report: Path, settings: DemoSettings, clip_frames: int) -> dict[str, Any]:
    """Write plot, strip and summary of the finished session; return the summary."""
    from cags_shaper.trace import open_trace

    frames, summary = read_lines(report / "frames.jsonl")
    seconds = max((frames[-1]["time_us"] - frames[0]["time_us"]) / 1e6, 0.1) if frames else 0.1
    plot_stream(frames, capacity_series(open_trace(link_trace(settings)), seconds), report / "timeline.png")
    chosen = telling_frame(frames)
    if chosen is not None:
        write_strip(report / "stages", chosen, report / "strip.png")
    run = {"trace": settings.trace, "share": settings.share, "delay_ms": settings.delay_ms, "clip_frames": clip_frames}
    merged = {**summary, "benchmark": "demo", **run, **provenance()}
    (report / "summary.json").write_text(json.dumps(merged, indent=2, sort_keys=True) + "\n", encoding="utf-8")
    return merged


def check_replaceable(out: Path) -> None:
    """Refuse to replace a folder that is not an earlier report."""
    if out.exists() and not (out.is_dir() and (not any(out.iterdir()) or (out / "summary.json").exists())):
        raise CagsError(f"{out}: exists and is not an earlier report; name another folder with --out")


def replace_folder(made: Path, out: Path) -> None:
    """Replace an earlier folder by a finished one."""
    if out.exists():
        shutil.rmtree(out)
    made.rename(out)
