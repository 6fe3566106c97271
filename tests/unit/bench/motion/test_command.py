"""``cags-bench motion``, played small."""

from __future__ import annotations

from pathlib import Path

import pytest

from cags_bench.motion.experiment import SHORT, TRACKS, WHOLE, _checks
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


def _line(way: str, top_bytes: int) -> dict[str, object]:
    rows = ("moved_a_frame", "changed_a_frame", "that_differ_a_frame", "that_differ_and_are_not_told_of")
    bytes_ = {"top_bytes_a_frame": top_bytes, "top_psnr_db": 50.0}
    return {"scene": "monkey", "way": way, **bytes_, **{f"rows_{name}": 0 for name in rows}}


@pytest.mark.parametrize(("tracks", "ok"), [(90, True), (110, False)])
def test_whole_splats_of_the_levels_that_show_are_a_rival_of_their_own(tracks: int, *, ok: bool) -> None:
    lines = [_line(WHOLE, 200), _line(TRACKS, tracks), _line(SHORT, 100)]
    checks = {check["name"].rpartition(": ")[2]: check for check in _checks(lines)}
    assert checks["times fewer bytes"]["value"] == round(200 / tracks, 2)
    assert checks["times fewer bytes than whole splats of the levels that show"]["ok"] is ok
    assert "times fewer bytes than whole splats of the levels that show" not in {
        check["name"].rpartition(": ")[2] for check in _checks(lines[:2])
    }
