"""The client's frame and the server's references: every way is timed, and what they show is right."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from cags_bench.align.measure import CORRECT, DIFFERENCE, PICTURE, RASTER, checks_of, interleaved
from cags_bench.align.settings import AlignBenchSettings
from cags_bench.cli import main
from cags_common.errors import ConfigError

SCENE = ["--scene", "procedural:size=600,frames=8", "--frames", "8", "--threads", "1"]


def frame(work: str, ms: float, size: str = "800x600") -> dict[str, Any]:
    return {"part": "frame", "work": work, "size": size, "ms": ms}


def judged(lines: list[dict[str, Any]]) -> dict[str, tuple[float, bool]]:
    return {one["name"]: (one["value"], one["ok"]) for one in checks_of(lines)}


def test_checks_speak_of_the_sizes_that_were_measured() -> None:
    assert judged([frame(RASTER, 9.0), frame(CORRECT, 2.5), frame(DIFFERENCE, 21.0)]) == {
        "correct at 800x600": (2.5, True),
        "whole frame at 800x600": (21.0, False),
    }
    assert judged([frame(CORRECT, 6.5, "1600x1200"), {"part": "server"}]) == {"correct at 1600x1200": (6.5, False)}


@pytest.mark.parametrize(
    ("changes", "words"),
    [({"sizes": "800"}, "sizes = '800'"), ({"sizes": "8x600"}, "sizes"), ({"clients": "0"}, "clients = '0'")],
)
def test_conditions_that_do_not_parse_are_named(changes: dict[str, str], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        AlignBenchSettings(**changes)


def test_ways_take_turns_and_the_warm_up_does_not_count() -> None:
    calls: list[str] = []
    works = {name: lambda name=name: calls.append(name) for name in ("a", "b")}
    found = interleaved(works, 3)  # type: ignore[arg-type]
    assert calls == ["a", "b"] * 5
    assert all(0 <= found[name]["least_ms"] <= found[name]["ms"] for name in found)


def test_frames_with_references_are_better_and_several_clients_are_served(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = ["align", *SCENE, "--sizes", "160x120", "--lod", "0", "--repetitions", "1", "--clients", "1,2"]
    assert main([*run, "--cache", str(tmp_path), "--json"]) == 0
    *lines, last = [json.loads(text) for text in capsys.readouterr().out.splitlines()]
    frames = {one["work"]: one for one in lines if one["part"] == "frame"}
    assert set(frames) == {RASTER, DIFFERENCE, PICTURE, CORRECT}
    own = frames[RASTER]["psnr_covered_db"]
    assert all(frames[work]["psnr_covered_db"] > own + 3 for work in (DIFFERENCE, PICTURE))
    assert frames[CORRECT]["psnr_covered_db"] == frames[DIFFERENCE]["psnr_covered_db"]
    served = {one["clients"]: one for one in lines if one["part"] == "server"}
    assert set(served) == {1, 2}
    assert served[2]["references"] > 1.5 * served[1]["references"]
    for one in served.values():
        assert min(one["truth_ms"], one["mirror_ms"], one["coding_ms"]) > 0
    assert last["checks"] == [], "no size was measured that a target is for"


def test_a_device_that_is_not_there_is_told_before_anything_is_encoded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAGS_GPU_ADAPTER", "no such adapter")
    assert main(["align", *SCENE, "--device", "gpu", "--cache", str(tmp_path)]) != 0
    assert "cags-bench: " in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
