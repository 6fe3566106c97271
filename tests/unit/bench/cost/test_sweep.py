"""``cags-bench cost``, played small: every stage runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from support.bench_lines import lines_of


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_cost_measures_every_stage_and_marks_what_is_shipped(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = ["--scene", "procedural:size=1000,frames=12", "--frames", "12", "--width", "64", "--height", "64"]
    link = ["--trace", "generated:steady-0.1", "--cache", str(tmp_path / "cache"), "--out", str(tmp_path / "page")]
    *points, summary = lines_of(capsys, "cost", *scene, *link, "--budget-ms", "50")
    checks = {check["name"]: check["ok"] for check in summary["checks"]}  # type: ignore[attr-defined]
    assert checks["stages"] and checks["stages with the shipped default marked"]
    assert len(points) == summary["points"]
    assert "<html" in (tmp_path / "page/index.html").read_text()
