"""``cags-bench cost``, played small: every stage runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from support.bench_lines import lines_of


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_cost_measures_every_stage_at_every_size_and_marks_what_is_shipped(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = ["--scenes", "procedural:size=1000,frames=12", "--frames", "12", "--sizes", "64x64,128x96"]
    often = ["--moments", "2", "--repetitions", "1", "--cache", str(tmp_path / "cache")]
    out = ["--out", str(tmp_path / "page"), "--budget-ms", "50", "--config-out", str(tmp_path / "c.toml")]
    *points, summary = lines_of(capsys, "cost", *scene, *often, *out)
    checks = {check["name"]: check for check in summary["checks"]}  # type: ignore[attr-defined]
    assert checks["stages without the product's default"]["value"] == []
    points = [one for one in points if "left_out" not in one]
    assert len(points) == summary["points"]
    assert {one["size"] for one in points} == {"", "64x64", "128x96"}
    assert all(one["observations"] >= 1 and one["runs"] >= 1 for one in points)
    drawn = [one for one in points if one["stage"] == "rasterise" and str(one["point"]).startswith("cpu")]
    assert [one["observations"] for one in drawn] == [2] * 6
    assert any(str(one["stage"]).startswith("session: ") for one in points)
    assert "<html" in (tmp_path / "page/index.html").read_text()
    assert "width = 128" in (tmp_path / "c.toml").read_text()
