"""``cags-bench restore`` and ``cags-bench align``: conditions, cases, methods, and how targets are judged."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cags_bench.align.frames import frame_checks, frame_table
from cags_bench.cli import main
from cags_bench.restore import cases
from cags_bench.restore.cases import spread
from cags_bench.restore.checks import checks_of, gain, time_checks
from cags_bench.restore.conditions import PREDICTED, Conditions
from cags_bench.restore.methods import adapted
from cags_common.errors import ConfigError

STAGES = ("raster", "align", "restore", "enlarge")
SMALL = ["--scene", "procedural:size=1500,seed=3,frames=1", "--sizes", "96x64", "--lods", "0", "--views", "1"]


def test_errors_are_degrees_and_centimetres_or_predicted() -> None:
    assert Conditions(errors="0/0, 5/20,predicted").error_list == [(0, 0), (5, 20), PREDICTED]


@pytest.mark.parametrize(
    ("field", "text"),
    [("errors", "5"), ("errors", "5/a"), ("errors", "181/0"), ("references", "3x"), ("lods", "2"), ("sizes", "8x8")],
)
def test_other_conditions_are_named(field: str, text: str) -> None:
    with pytest.raises(ConfigError, match=field):
        Conditions(**{field: text})


def _line(method: str, psnr: float, **more: object) -> dict[str, object]:
    usual = {"lod_share": 0.0, "error": "0/0", "reference": "footprint", "covered": 1.0, "size": "1600x1200"}
    return {"method": method, "psnr_covered_db": psnr, "distorted_psnr_covered_db": 25.0, **usual, **more}


def _judged(lines: list[dict[str, object]]) -> dict[str, tuple[object, bool]]:
    return {c["name"]: (c["value"], c["ok"]) for c in checks_of(lines)}


def test_gain_kept_compares_an_error_with_none() -> None:
    judged = _judged([_line("affine", 35.0), _line("affine", 34.0, error="5/0"), _line("affine", 31.0, error="5/20")])
    assert judged["affine: gain kept at an error of 5/0 (degrees/cm), base LoD"] == (pytest.approx(0.9), True)
    assert judged["affine: gain kept at an error of 5/20 (degrees/cm), base LoD"] == (pytest.approx(0.6), False)
    assert not any("2/10" in name for name in judged)


def test_gain_kept_is_judged_at_the_predicted_pose_too() -> None:
    judged = _judged([_line("affine", 35.0), _line("affine", 32.0, error="predicted")])
    assert judged["affine: gain kept at the predicted pose, base LoD"] == (pytest.approx(0.7), False)


def test_a_full_frame_is_asked_for_more_than_an_object() -> None:
    room, thing = _judged([_line("affine", 28.0)]), _judged([_line("affine", 28.0, covered=0.4)])
    assert room["affine: gain where distorted is 24-29 dB, a full frame"] == (3.0, False)
    assert thing["affine: gain where distorted is 24-29 dB, an object"] == (3.0, True)


def test_one_loss_is_enough_to_fail_never_lower() -> None:
    judged = _judged([_line("lite", 30.0), _line("lite", 24.8, lod_share=0.5)])
    assert judged["lite never lower than distorted"] == (pytest.approx(-0.2), False)
    assert "lite at the top of the ladder" not in judged


def test_targets_are_judged_with_shipped_references_and_both_kinds_compared() -> None:
    judged = _judged([_line("affine", 30.0), _line("affine", 24.0, reference="plain")])
    assert judged["affine never lower than distorted"] == (5.0, True)
    assert judged["affine: the client's footprint against a plain reference"] == (6.0, True)


def test_tiers_are_compared_below_the_top() -> None:
    lines = [_line("affine", 30.0), _line("lite", 30.8), _line("srresnet", 31.0)]
    judged = _judged([*lines, _line("lite", 20.0, lod_share=1.0)])
    assert judged["lite against affine"] == (pytest.approx(0.8), True)
    assert judged["lite against srresnet"] == (pytest.approx(-0.2), True)


def test_single_stages_are_judged_by_their_own_time() -> None:
    times = {"align_ms": 4.0, "own_ms": 6.0, "restore_ms": 9.0}
    judged = {c["name"]: c for c in time_checks([_line("affine", 30.0, **times)], 2)}
    assert judged["affine at 1600x1200, 2 threads"]["ok"]
    assert judged["affine at 1600x1200, 2 threads"]["value"] == 9.0


def test_frames_are_judged_at_the_lowest_lod_at_every_accuracy() -> None:
    rest = {"new_reference_frame_ms": 50.0, "psnr_covered_db": 30.0}
    lines = [
        {"frame": name, "size": "1600x1200", "lod_share": lod, "frame_ms": ms + 10 * lod, **rest}
        for lod in (0.25, 0.0)
        for name, ms in (("whole", 40.0), ("half", 20.0))
    ]
    judged = {c["name"].rpartition("; ")[2]: (c["value"], c["ok"]) for c in frame_checks(lines)}
    assert judged == {"whole": (40.0, False), "half": (20.0, True)}
    assert frame_table(lines)["1600x1200, LoD 0"]["half"] == {"frame_ms": 20.0, **rest}


def _run(arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> list[dict[str, object]]:
    assert main([*arguments, *SMALL, "--cache", str(tmp_path), "--repetitions", "0", "--threads", "1", "--json"]) == 0
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_every_method_runs_on_every_kind_of_reference(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    methods = "none,aligned,affine,affine with own depth,sirt,sirt + affine"
    references = "footprint,plain,2x,full"
    *lines, last = _run(
        ["restore", "--methods", methods, "--references", references, "--errors", "2/5"], tmp_path, capsys
    )
    assert {(x["method"], x["reference"]) for x in lines} == {
        (m, r) for m in methods.split(",") for r in references.split(",")
    }
    for line in lines:
        assert line["error_deg"] == pytest.approx(2.0, abs=1e-3)
        assert line["error_cm"] == pytest.approx(5.0, abs=1e-3)
        assert line["reference_bytes"] > 100
        assert np.isfinite(line["psnr_covered_db"])
    assert all(gain(x) == 0 for x in lines if x["method"] == "none")
    assert all(gain(x) > 0 for x in lines if x["method"] == "affine" and x["reference"] != "plain")
    assert {"reference plain", "error 2/5", "lod 0", "ssim"} <= set(last["table"]["affine"])


def test_align_times_the_other_stages_and_follows_a_recorded_walk(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    walk = tmp_path / "walk.csv"
    _write_walk(walk)
    *lines, last = _run(["align", "--poses", str(walk), "--errors", "predicted"], tmp_path, capsys)
    assert {x["error"] for x in lines if "method" in x} == {"predicted"}
    assert all(0 < x["error_deg"] < 30 for x in lines if "method" in x)
    assert lines[-1]["adapt_ms"] > 0
    drawn = {x["frame"]: x for x in lines if "frame" in x}
    assert len(drawn) == 4
    for x in drawn.values():
        assert x["frame_ms"] == pytest.approx(sum(x.get(f"{s}_ms", 0) for s in STAGES), rel=1e-6)
        assert x["psnr_covered_db"] > x["distorted_psnr_covered_db"]
    names = {c["name"] for c in last["checks"]}
    assert "pixels called occluded under an identity, 96x64" in names
    assert "affine: gain at the base LoD" in names


def test_the_papers_client_table_names_its_device(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    *lines, last = _run(["align", "--device", "cpu", "--errors", "2/5"], tmp_path, capsys)
    assert [x["stage"] for x in lines] == ["render", "PRPA", "srresnet", "lite"]
    assert all(x["ms"] >= x["least_ms"] > 0 for x in lines)
    assert last["device"] == lines[0]["device"] == lines[0]["machine"]
    assert last["checks"] == [], "the paper's figures are a graphics card's"


def test_the_client_table_of_a_device_that_is_not_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAGS_GPU_ADAPTER", "no such adapter")
    assert main(["align", "--device", "gpu", *SMALL, "--cache", str(tmp_path)]) != 0
    assert "cags-bench: " in capsys.readouterr().err
    assert not list(tmp_path.iterdir()), "nothing was encoded for it"


def test_references_of_the_walk_before_come_oldest_first_each_with_an_error_of_its_own(tmp_path: Path) -> None:
    settings = Conditions(scene=SMALL[1], sizes="96x64", lods="0", views=1, cache=str(tmp_path), threads=1, history=3)
    every = cases.Cases(settings)
    case = every.first((96, 64), (5.0, 20.0))
    assert len(case.before) == 3
    places = np.array([r.camera.pose.position for r in (*case.before, case.reference)])
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert (steps > 0.02).all(), "errors of other directions, not the walk's own steps alone"
    assert adapted(case).distorted.rgb.shape == case.distorted.rgb.shape
    alone = adapted(replace(case, before=()))
    assert not np.array_equal(adapted(case).distorted.rgb, alone.distorted.rgb)


def test_views_lie_over_all_moments_that_see_the_scene() -> None:
    assert spread([1, 2, 3, 4, 5, 6], 3) == [1, 3, 5]
    assert spread([1, 2], 3) == [1, 2, 1]


def test_a_walk_that_never_sees_the_scene_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cases, "LEAST_COVERED", 1.1)
    with pytest.raises(ConfigError, match="never see"):
        cases.Cases(Conditions(scene=SMALL[1], cache=str(tmp_path)))


def _write_walk(path: Path) -> None:
    from cags_common.poses import Focus, synthetic_walk, write_poses

    write_poses(synthetic_walk("walking", Focus((0.0, 0.0, 0.0), 1.0, (0.0, 1.0, 0.0)), seed=5), path)


def test_an_unknown_method_is_told_with_all_that_there_are(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["restore", "--methods", "affine,swap"]) == 2
    said = capsys.readouterr().err
    assert "method 'swap' is unknown" in said
    assert all(known in said for known in ("lite", "sirt + affine", "paper", "cr-no-ref"))
    assert said.count("\n") == 1
