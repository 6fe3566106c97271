"""``cags-bench motion``, played small."""

from __future__ import annotations

from pathlib import Path

import pytest

from support.bench_lines import lines_of


@pytest.mark.slow
def test_motion_compares_tracks_with_splats_sent_whole(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = [
        "--scenes",
        "procedural:size=500,frames=18",
        "--parts",
        "rates,times",
        "--frames",
        "18",
        "--judged",
        "1",
        "--views",
        "1",
    ]
    small = ["--workers", "1", "--repetitions", "1", "--cache", str(tmp_path)]
    *_, summary = lines_of(capsys, "motion", *scene, *small)
    checks = {check["name"].rpartition(": ")[2]: check for check in summary["checks"]}  # type: ignore[attr-defined]
    assert checks["times fewer bytes"]["value"] > 1
    assert checks["rows that differ and are not reported"]["ok"]
