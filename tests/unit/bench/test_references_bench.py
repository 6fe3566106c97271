"""Kinds of reference beside each other: what is played, what is counted, what is asked, and the state before."""

from __future__ import annotations

import json
import math
import stat
import sys
from pathlib import Path
from typing import Any

import pytest

from cags_bench.cli import main
from cags_bench.references.before import played_before, read_baseline
from cags_bench.references.cases import Case, cases_of, figures_of
from cags_bench.references.checks import checks_of, pairs_of
from cags_bench.references.methods import METHODS
from cags_bench.references.settings import ReferenceBenchSettings
from cags_client.settings import ClientSettings
from cags_common.errors import ConfigError
from cags_server.settings import ServerSettings

SMALL = ["--scenes", "procedural:size=600,frames=8", "--poses", "synthetic:walking", "--frames", "8"]
SIZE = ["--width", "96", "--height", "72"]

Line = dict[str, Any]


def line(method: str, psnr_db: float, link: float = 10.0, **more: Any) -> Line:
    label = {"scene": "room", "link_mbps": link, "poses": "walk.csv", "frames": 45, "size": "480x360"}
    figures = {"psnr_db": psnr_db, "flicker": 1.0, "reference_bytes": 100, "worse_0.5_db_share": 0.0}
    return {"benchmark": "references", "method": method, **label, **figures, **more}


def judged(lines: list[Line], earlier: list[Line]) -> dict[str, tuple[object, bool]]:
    return {one["name"]: (one["value"], one["ok"]) for one in checks_of(lines, earlier)}


# --------------------------------------------------------------------------- what is played


def test_every_method_is_one_that_the_program_accepts() -> None:
    for method in METHODS.values():
        ServerSettings(**method.server)
        ClientSettings(**method.client)
        assert method.note


def test_each_scene_has_its_walk_and_with_full_every_walk() -> None:
    settings = {"scenes": "a;b;c", "poses": "one;two", "links": "10,60"}
    quick = list(cases_of(ReferenceBenchSettings(**settings)))
    assert [(c.scene, c.poses) for c in quick if c.link_mbps == 10] == [("a", "one"), ("b", "two"), ("c", "one")]
    assert len(quick) == 6
    full = list(cases_of(ReferenceBenchSettings(**settings, full=True)))
    assert len(full) == 12
    assert full[0].frames > quick[0].frames


def test_labels_do_not_depend_on_where_files_lie() -> None:
    here, there = (Case(f"motion:{folder}/plant.splat", 10, f"{folder}/w.csv", 9, 8, 6).label for folder in ("/a", "b"))
    assert here == there
    assert here["scene"] == "motion:plant.splat"


def test_scenes_that_are_not_there_are_left_out(tmp_path: Path) -> None:
    assert ReferenceBenchSettings(shared=str(tmp_path)).scene_list == ["procedural:size=30000"]
    assert ReferenceBenchSettings(shared=str(tmp_path)).walk_list == ["synthetic:walking"]
    assert ReferenceBenchSettings(shared=str(tmp_path)).lpips_file == ""
    (tmp_path / "scenes" / "monkey").mkdir(parents=True)
    assert ReferenceBenchSettings(shared=str(tmp_path)).scene_list[1:] == [str(tmp_path / "scenes" / "monkey")]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"methods": "auto,swap"}, "'swap' is unknown; known: auto"),
        ({"links": "fast"}, "rates in Mbps"),
        ({"links": "10,-1"}, "must lie in"),
        ({"baseline": "a.jsonl", "before": "python"}, "give one of them"),
    ],
)
def test_what_cannot_be_played_is_named(changes: dict[str, str], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        ReferenceBenchSettings(**changes)


# --------------------------------------------------------------------------- what is counted


def test_losses_are_counted_against_the_clients_own_splats() -> None:
    frames = [
        {"psnr_covered_restored_db": shown, "psnr_covered_distorted_db": own, "reference_kind": kind}
        for shown, own, kind in [(40.0, 30.0, "difference"), (39.7, 40.0, "picture"), (38.0, 39.0, "picture")]
    ]
    frames.append({"psnr_covered_restored_db": math.inf, "psnr_covered_distorted_db": 30.0, "reference_kind": ""})
    out = figures_of(frames, {"bytes_reference": 400, "bytes_tiles": 10, "frames_missed": 0})
    assert out["worst_loss_db"] == pytest.approx(1.0)
    assert out["worse_0.1_db_share"] == pytest.approx(2 / 3)
    assert out["worse_0.5_db_share"] == pytest.approx(1 / 3)
    assert out["psnr_db"] == pytest.approx((40.0 + 39.7 + 38.0) / 3), "a frame that is exact has no finite figure"
    assert out["reference_bytes_a_frame"] == 100
    assert out["kinds"] == {"difference": 0.25, "no reference": 0.25, "picture": 0.5}


def test_records_without_kinds_are_read_too() -> None:
    frames = [{"psnr_covered_restored_db": 30.0, "psnr_covered_distorted_db": None}]
    out = figures_of(frames, {"bytes_reference": 0, "bytes_tiles": 0, "frames_missed": 0})
    assert out["kinds"] == {"unknown": 1.0}
    assert math.isnan(out["worst_loss_db"])


# --------------------------------------------------------------------------- what is asked


def test_the_state_before_is_compared_case_by_case() -> None:
    before = [line("before", 38.0, reference_bytes=200), line("before", 41.0, link=30, reference_bytes=200)]
    ours = [line("auto", 40.0, flicker=0.5), line("auto", 40.5, link=30, flicker=2.0), line("auto", 9.0, link=60)]
    found = judged(ours, before)
    assert found["mean gain over the state before, dB"] == (0.75, False)
    value, ok = found["no case below the state before, dB"]
    assert not ok
    assert str(value).startswith("-0.50 (room, 30 Mbps")
    assert found["cases that flicker as much as before"] == (["room, 30 Mbps, walk.csv"], False)
    assert found["reference bytes less than before"] == (0.5, True)


def test_other_methods_are_compared_with_in_the_same_run() -> None:
    found = judged([line("auto", 40.0), line("none", 40.2), line("picture", 41.0)], [])
    assert found["auto against none, worst case, dB"][1]
    assert not found["auto against picture, worst case, dB"][1]
    assert "mean gain over the state before, dB" not in found


def test_cases_of_another_size_are_no_pair() -> None:
    assert pairs_of([line("auto", 40.0)], [line("before", 38.0, size="800x600")]) == []


# --------------------------------------------------------------------------- before, now


def test_a_baseline_is_what_an_earlier_run_compared_with_or_its_own_default(tmp_path: Path) -> None:
    path = tmp_path / "earlier.jsonl"
    rows = [line("auto", 40.0), line("none", 35.0), {"benchmark": "references", "summary": True}]
    path.write_text("\n".join(map(json.dumps, rows)) + "\n")
    assert [one["psnr_db"] for one in read_baseline(path)] == [40.0]
    path.write_text("\n".join(map(json.dumps, [*rows, line("before", 38.0)])) + "\n")
    assert [one["psnr_db"] for one in read_baseline(path)] == [38.0]


@pytest.mark.parametrize("text", ["", "no json", json.dumps({"benchmark": "stream"})])
def test_a_baseline_without_cases_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "earlier.jsonl"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"baseline = .*(contains no case|cannot be read)"):
        read_baseline(path)


def test_an_earlier_installation_that_fails_is_quoted(tmp_path: Path) -> None:
    case = Case("procedural:size=600,frames=8", 30, "synthetic:walking", 8, 96, 72, str(tmp_path / "bundles"))
    with pytest.raises(ConfigError, match="is not a program"):
        played_before(str(tmp_path / "python"), case)
    broken = tmp_path / "python"
    broken.write_text("#!/bin/sh\necho it is broken >&2\nexit 3\n")
    broken.chmod(broken.stat().st_mode | stat.S_IXUSR)
    with pytest.raises(ConfigError, match="its message: it is broken"):
        played_before(str(broken), case)


def test_every_method_is_played_and_this_installation_stands_for_an_earlier_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Playing the same cases through ``cags-bench stream`` gives the default method's figures."""
    run = ["references", "--json", "--shared", str(tmp_path), "--links", "30", *SMALL, *SIZE]
    assert main([*run, "--cache", str(tmp_path / "bundles"), "--before", sys.executable]) == 0
    *lines, last = [json.loads(text) for text in capsys.readouterr().out.splitlines()]
    by = {one["method"]: one for one in lines}
    assert set(by) == {*METHODS, "before"}
    for one in lines:
        assert one["psnr_db"] > 10
        assert (one["reference_bytes"] == 0) == (one["method"] == "none")
    assert by["before"]["psnr_db"] == pytest.approx(by["auto"]["psnr_db"], abs=1e-6)
    assert by["before"]["reference_bytes"] == by["auto"]["reference_bytes"]
    assert by["difference"]["server_mirror_ms"] > 10 * by["picture"]["server_mirror_ms"], "pictures compare nothing"
    assert all(by[name]["client_ms"] > 0 and by[name]["server_ms"] > 0 for name in METHODS)
    assert {one["name"]: one["value"] for one in last["checks"]}["mean gain over the state before, dB"] == 0
    assert set(last["means"]) == set(by)
