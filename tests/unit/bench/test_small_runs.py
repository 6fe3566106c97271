"""Commands that measure for long, played small: every part runs, every line is complete, checks are made."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cags_bench.cli import main
from cags_common.poses import Focus, synthetic_walk, write_poses


def lines_of(capsys: pytest.CaptureFixture[str], *arguments: str) -> list[dict[str, object]]:
    assert main([*arguments, "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert lines[-1]["summary"] is True
    assert all(set(line) >= {"commit", "machine", "versions"} for line in lines)
    return lines


def test_predict_judges_every_predictor_and_policy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    around = Focus((0.0, 0.0, 0.0), 2.0, (0.0, -1.0, 0.0))
    for seed, person in enumerate(("01", "02", "09", "10")):
        walk = synthetic_walk("walking", around, seed=seed, duration_s=4.0)
        write_poses(walk, tmp_path / f"room_user{person}.csv")
    choices = ["--horizons-ms", "100,200", "--every-ms", "400", "--people", "all", "--seconds", "2"]
    lines = lines_of(capsys, "predict", "--poses", str(tmp_path), *choices)
    found = json.dumps(lines)
    assert all(name in found for name in ("hold", "linear", "autoregressive", "kalman", "fixed", "quantile", "lstm"))
    errors = [value for line in lines for key, value in line.items() if key.startswith("angular")]
    assert errors and all(0 <= float(error) < 30 for error in errors)  # type: ignore[arg-type]


@pytest.mark.slow
def test_motion_compares_tracks_with_splats_sent_whole(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = ["--scenes", "procedural:size=500,frames=18", "--frames", "18", "--judged", "1", "--views", "1"]
    small = ["--workers", "1", "--repetitions", "1", "--cache", str(tmp_path)]
    *_, summary = lines_of(capsys, "motion", *scene, *small)
    checks = {check["name"].rpartition(": ")[2]: check for check in summary["checks"]}  # type: ignore[attr-defined]
    assert checks["times fewer bytes"]["value"] > 1
    assert checks["rows that differ and are not told of"]["ok"]


@pytest.mark.slow
def test_cost_measures_every_stage_and_marks_what_is_shipped(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = ["--scene", "procedural:size=2000,frames=12", "--frames", "12", "--width", "64", "--height", "64"]
    link = ["--trace", "generated:steady-0.2", "--cache", str(tmp_path / "cache"), "--out", str(tmp_path / "page")]
    *points, summary = lines_of(capsys, "cost", *scene, *link, "--budget-ms", "50")
    checks = {check["name"]: check["ok"] for check in summary["checks"]}  # type: ignore[attr-defined]
    assert checks["stages"] and checks["points a stage"] and checks["stages with the shipped default marked"]
    assert len(points) == summary["points"]
    assert "<html" in (tmp_path / "page/index.html").read_text()
