"""What ``cags-bench demo`` makes of plays, and that its targets can fail."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import pytest

from cags_bench.demo.experiment import TARGETS, _spinning, checks_of, demo_lines, figures_of, figures_of_play
from cags_bench.demo.settings import DemoBenchSettings
from cags_common.errors import ConfigError

FRAMES, FPS = 90, 30


def play(frames: list[int], *, psnr: float = 40.0, stalled: bool = False) -> dict[str, Any]:
    """A play of which so many of 90 frames were displayed; ``stalled``: nothing came in its second second."""
    records = [
        {
            "frame": frame,
            "time_us": 1_000_000 * frame // FPS,
            "latency_ms": 10.0,
            "lod_mean": 3.0,
            "bytes_tiles": 0 if stalled and FPS <= frame < 2 * FPS else 3_000,
            "bytes_reference": 0,
            "psnr_restored_db": psnr,
        }
        for frame in frames
    ]
    return figures_of_play(records, {"clip_frames": FRAMES, "commit": "abc"})


def lines(*plays: dict[str, Any], case: str = "quiet") -> list[dict[str, Any]]:
    return [{"case": case, "state": "now", **figures} for figures in plays]


def verdicts(some: list[dict[str, Any]]) -> dict[str, bool]:
    return {check["name"]: check["ok"] for check in checks_of(some)}


def test_a_whole_play_meets_every_target() -> None:
    whole = play(list(range(FRAMES)))
    assert whole["displayed_per_s"] == pytest.approx(FPS)
    assert whole["least_second_kbps"] == pytest.approx(30 * 3_000 * 8 / 1e3)
    assert all(verdicts(lines(whole)).values())
    assert all(verdicts(lines(whole, case="busy")).values())
    assert set(verdicts(lines(whole))) == {f"quiet: {name}" for name, _, _ in TARGETS["quiet"]}


@pytest.mark.parametrize(
    ("broken", "case", "target"),
    [
        (play(list(range(0, FRAMES, 2))), "quiet", "quiet: displayed_per_s"),
        (play([frame for frame in range(FRAMES) if frame % 9]), "quiet", "quiet: even_share"),
        (play(list(range(FRAMES)), psnr=36.9), "quiet", "quiet: psnr_restored_db"),
        (play(list(range(0, FRAMES, 3))), "busy", "busy: displayed_per_s"),
        (play(list(range(FRAMES)), stalled=True), "busy", "busy: least_second_kbps"),
        (play([0]), "busy", "busy: displayed_per_s"),
        ({}, "quiet", "quiet: psnr_restored_step_p95_db"),
    ],
)
def test_a_play_that_misses_a_target_is_told(broken: dict[str, Any], case: str, target: str) -> None:
    assert not verdicts(lines(broken, case=case))[target]


def test_of_several_plays_the_median_counts_and_the_extremes_are_told() -> None:
    some = lines(play(list(range(FRAMES))), play(list(range(FRAMES))), play(list(range(0, FRAMES, 2))))
    assert verdicts(some)["quiet: displayed_per_s"]
    figures = figures_of(some)["quiet now"]["displayed_per_s"]
    assert (figures["lowest"], figures["median"]) == (pytest.approx(FPS / 2), pytest.approx(FPS))


def test_the_load_keeps_one_core_busy_and_ends_with_the_play() -> None:
    core = min(os.sched_getaffinity(0))
    with _spinning([core]) as (process,):
        deadline = time.monotonic() + 20
        while os.sched_getaffinity(process.pid) != {core} or _ticks(process.pid) < 20:
            assert process.poll() is None, "it has ended"
            assert time.monotonic() < deadline, "it takes no time of its core"
            time.sleep(0.02)
    assert process.poll() is not None


def _ticks(pid: int) -> int:
    """Processor time in user mode, 10 ms each."""
    return int(Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[11])


def test_more_cores_than_there_are_cannot_be_loaded() -> None:
    with pytest.raises(ConfigError, match=r"busy_cores = 256: this process may use \d+; give fewer"):
        next(demo_lines(DemoBenchSettings(busy_cores=256)))


@pytest.mark.parametrize(
    ("settings", "words"), [({"parts": "quiet,loud"}, "'loud' is unknown"), ({"runs": 0}, "runs = 0")]
)
def test_wrong_settings_are_told(settings: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        DemoBenchSettings(**settings)


def test_an_earlier_state_that_is_no_program_is_told() -> None:
    with pytest.raises(ConfigError, match="before = '/nowhere' is not a program"):
        next(demo_lines(DemoBenchSettings(before="/nowhere")))
