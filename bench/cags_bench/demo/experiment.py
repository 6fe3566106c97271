"""The experiment behind ``cags-bench demo``: alternating plays, each in its own processes."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from cags_bench.demo.settings import BUSY, QUIET, DemoBenchSettings
from cags_bench.doctor.machine import usable_cores
from cags_bench.jsonl import JsonObject, check, provenance, summary
from cags_bench.programs import executable
from cags_bench.stream_report import read_lines
from cags_client.output.steadiness import steadiness
from cags_common.errors import ConfigError

NOW, BEFORE = "now", "before"

FIGURES = (
    "displayed_per_s",
    "even_share",
    "psnr_restored_db",
    "psnr_restored_p5_db",
    "psnr_restored_step_p95_db",
    "least_second_kbps",
)
"""Figures in the summary for every part and state: median, minimum and maximum over the runs."""

TARGETS = {
    QUIET: (
        ("displayed_per_s", ">=", 27.0),
        ("even_share", ">=", 0.95),
        ("psnr_restored_db", ">=", 37.0),
        ("psnr_restored_step_p95_db", "<=", 2.0),
    ),
    BUSY: (("displayed_per_s", ">=", 15.0), ("least_second_kbps", ">", 0.0)),
}
"""Targets for the medians of the current state."""

SPIN = "import os, sys\nos.sched_setaffinity(0, {int(sys.argv[1])})\nwhile True:\n    pass\n"


def demo_lines(settings: DemoBenchSettings) -> Iterator[JsonObject]:
    """Yield one line per play, with alternating states, and the summary. Raises :class:`ConfigError`."""
    pythons = {NOW: sys.executable}
    if settings.before:
        pythons[BEFORE] = str(executable("before", settings.before))
    cores = _cores_to_load(settings) if BUSY in settings.part_list else []
    lines: list[JsonObject] = []
    for python in pythons.values():
        _played(python, settings)  # warm-up: encodes the scene and fills the file cache
    for part in settings.part_list:
        for number in range(settings.runs):
            for state, python in pythons.items():
                with _spinning(cores if part == BUSY else []):
                    figures = _played(python, settings)
                line = {"benchmark": "demo", "case": part, "state": state, "run": number, **figures}
                lines.append(line)
                yield line | {"cores": usable_cores(), "seed": 0, "warm_up": 1, "repetitions": 1, **provenance()}
    yield summary("demo", checks_of(lines), figures=figures_of(lines), repetitions=settings.runs)


def _cores_to_load(settings: DemoBenchSettings) -> list[int]:
    """Numbers of the cores to occupy. Raises :class:`ConfigError` if there are too few."""
    if not hasattr(os, "sched_getaffinity"):
        raise ConfigError("parts: busy needs Linux to bind processes to cores; give --parts quiet")
    cores = sorted(os.sched_getaffinity(0))
    if settings.busy_cores > len(cores):
        raise ConfigError(f"busy_cores = {settings.busy_cores}: this process may use {len(cores)}; give fewer")
    return cores[: settings.busy_cores]


def _played(python: str, settings: DemoBenchSettings) -> JsonObject:
    with tempfile.TemporaryDirectory(prefix="cags-demo-bench-") as scratch:
        out = Path(scratch) / "report"
        command = [python, "-m", "cags_bench.demo.cli", settings.scene, "--json", "--out", str(out)]
        if settings.cache:
            command += ["--cache", settings.cache]
        finished = subprocess.run(command, capture_output=True, text=True, check=False)
        if finished.returncode:
            message = (finished.stderr.strip().splitlines() or ["nothing"])[-1]
            raise ConfigError(f"cags-demo of {python} did not play {settings.scene}; its message: {message}")
        reported = json.loads(finished.stdout.splitlines()[-1])
        frames, _ = read_lines(out / "frames.jsonl")
    return figures_of_play(frames, reported)


def figures_of_play(frames: Sequence[Mapping[str, Any]], reported: Mapping[str, Any]) -> JsonObject:
    """Figures of one play, from records and summary fields that any installation writes."""
    period_us = 0.0
    if len(frames) > 1:  # from the due times of frames
        period_us = (frames[-1]["time_us"] - frames[0]["time_us"]) / (frames[-1]["frame"] - frames[0]["frame"])
    known = [value for frame in frames if (value := frame.get("psnr_restored_db")) is not None]
    return {
        "displayed": len(frames),
        "clip_frames": reported["clip_frames"],
        "displayed_per_s": len(frames) * 1e6 / (reported["clip_frames"] * period_us) if period_us else 0.0,
        "psnr_restored_db": sum(known) / len(known) if known else None,
        "least_second_kbps": _least_second_kbps(frames),
        "played_commit": reported.get("commit"),
        **steadiness(frames),
    }


def _least_second_kbps(frames: Sequence[Mapping[str, Any]]) -> float:
    """Media bitrate in the play's poorest whole second."""
    if not frames:
        return 0.0
    begin_us, end_us = frames[0]["time_us"], frames[-1]["time_us"]
    seconds = [0] * max(int((end_us - begin_us) // 1_000_000), 1)
    for frame in frames:
        second = int((frame["time_us"] - begin_us) // 1_000_000)
        if second < len(seconds):
            seconds[second] += frame["bytes_tiles"] + frame["bytes_reference"]
    return min(seconds) * 8 / 1e3


@contextlib.contextmanager
def _spinning(cores: Sequence[int]) -> Iterator[list[subprocess.Popen[bytes]]]:
    """Run a process on each of ``cores`` that occupies it."""
    running = [subprocess.Popen([sys.executable, "-c", SPIN, str(core)]) for core in cores]
    try:
        yield running
    finally:
        for process in running:
            process.kill()
            process.wait()


def figures_of(lines: Sequence[Mapping[str, Any]]) -> JsonObject:
    """Median, minimum and maximum of each figure, by part and state."""
    out: JsonObject = {}
    for key in dict.fromkeys((line["case"], line["state"]) for line in lines):
        matching = [line for line in lines if (line["case"], line["state"]) == key]
        out[" ".join(key)] = {
            name: {"median": median(values), "lowest": min(values), "highest": max(values)}
            for name in FIGURES
            if (values := [line[name] for line in matching if line.get(name) is not None])
        }
    return out


def checks_of(lines: Sequence[Mapping[str, Any]]) -> Iterator[JsonObject]:
    """Checks of the targets against the medians of the current state; a missing figure fails."""
    figures = figures_of(lines)
    for part in dict.fromkeys(line["case"] for line in lines):
        measured = figures.get(f"{part} {NOW}", {})
        for name, relation, bound in TARGETS[part]:
            value = measured.get(name, {}).get("median")
            holds = {">=": float.__ge__, "<=": float.__le__, ">": float.__gt__}[relation]
            yield check(
                f"{part}: {name}", f"{relation} {bound:g}", value, value is not None and holds(float(value), bound)
            )
