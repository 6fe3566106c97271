"""The codec benchmark: its lines are consistent, and its verdicts follow from them."""

import argparse
from pathlib import Path
from typing import Any

import pytest

from cags_bench.codec import readers
from cags_bench.codec.ablation import VARIANTS, Variant, gains
from cags_bench.codec.checks import checks
from cags_bench.codec.command import add_arguments, run
from cags_bench.codec.readers import PACKAGE, SplatTransform
from cags_bench.codec.scaling import scaling
from cags_common.errors import ConfigError


def options(*arguments: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    return parser.parse_args(arguments)


@pytest.fixture(scope="module")
def lines() -> list[dict[str, Any]]:
    few = ("--quantisers", "layered", "--views", "1", "--points", "2", "--width", "64", "--repeats", "1")
    given = options("procedural:size=600", *few)
    given.lpips = None
    return list(run(given))


def test_lines_split_the_bytes_of_every_lod(lines: list[dict[str, Any]]) -> None:
    ladder = [line for line in lines if line.get("codec") == "layered"]
    assert ladder[0]["lod"] == 0
    for line in ladder:
        parts = sum(line[f"bytes_{part}"] for part in ("positions", "base", "layers", "codebooks"))
        assert line["bytes"] == parts
        assert line["bytes_a_splat"] == pytest.approx((parts - line["bytes_codebooks"]) / line["splats"])
    assert ladder[0]["bytes_layers"] == 0 < ladder[-1]["bytes_layers"]
    assert ladder[0]["psnr_db"] < ladder[-1]["psnr_db"]


def test_every_peer_is_there_or_says_why_not(lines: list[dict[str, Any]]) -> None:
    assert {line["codec"] for line in lines[:-1]} == {"layered", "spz", "draco", "gzip-float32", "sog"}
    sog = next(line for line in lines if line.get("codec") == "sog")
    assert "npm install @playcanvas/splat-transform" in sog["skipped"]
    assert lines[-1]["summary"]
    assert {c["name"].split()[0] for c in lines[-1]["checks"]} >= {"decode_ms_150k", "changed_decode_ms"}


def line(codec: str, size: float, quality: float, ms: float = 1.0, **more: Any) -> dict[str, Any]:
    always = {"scene": "s", "sh_degree": 0, "splats": 150_000, "changed_splats": 4_000, "changed_decode_ms": ms / 10}
    return {**always, "codec": codec, "lod": size, "bytes": size, "bytes_a_splat": size, "psnr_db": quality, **more} | {
        "decode_ms": ms
    }


def verdicts(*given: dict[str, Any]) -> dict[str, bool]:
    return {c["name"]: c["ok"] for c in checks(given)}


def test_verdicts_follow_from_the_lines() -> None:
    ours = [line("layered", size, quality, 12.0) for size, quality in ((4, 25), (7, 35), (10, 45))]
    paper = [line("paper-66", size, quality) for size, quality in ((4, 20), (7, 28), (10, 36))]
    good = verdicts(*ours, *paper, line("spz", 18, 44, reader_ms={"gsply": 30.0, "other": None}))
    assert all(good.values())
    assert set(good) == {
        *("bd_psnr_db, bd_rate", "bd_psnr_db_worst", "top_lod s", "decode_ms_150k s", "changed_decode_ms s"),
        *("decode_beside spz s", "bytes_beside spz s"),
    }
    slow = [{**x, "decode_ms": 25.0, "changed_decode_ms": 2.5, "bytes_a_splat": 12} for x in ours]
    bad = verdicts(*slow, *[{**x, "codec": "paper-66", "psnr_db": x["psnr_db"] + 1} for x in ours])
    assert not any(bad.values())


def test_a_peer_that_looks_better_than_every_level_is_no_win() -> None:
    given = [line("layered", 4, 25), line("sog", 13, 48, reader_ms={"own": 80.0})]
    assert not verdicts(*given)["decode_beside sog s"]
    assert not verdicts(*given)["bytes_beside sog s"]
    finer = line("layered-fine", 12, 49)
    assert verdicts(*given, finer)["decode_beside sog s"]
    assert verdicts(*given, finer)["bytes_beside sog s"]


def test_a_folder_without_the_package_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="npm install @playcanvas/splat-transform"):
        SplatTransform.find(str(tmp_path))
    assert PACKAGE.name == "splat-transform"


def clip(workers: int, total_s: float, sha256: str = "a") -> dict[str, Any]:
    return {"clip": "c", "workers": workers, "total_s": total_s, "sha256": sha256}


def test_more_workers_are_held_against_the_first_number() -> None:
    good = verdicts(clip(1, 10.0), clip(2, 6.0))
    assert good == {"encode_speed_up 1 -> 2 workers": True, "encode_same_bytes 1 -> 2 workers": True}
    assert not any(verdicts(clip(1, 10.0), clip(2, 8.0, "b")).values())


def test_a_clip_is_encoded_by_each_number_of_workers() -> None:
    (line,) = scaling("procedural:size=1000,frames=3", 2, [1])
    assert (line["frames"], line["workers"], len(line["sha256"])) == (2, 1, 64)
    assert set(line["stages_s"]) >= {"sample", "codebooks", "encode"}
    assert sum(line["stages_s"].values()) <= line["total_s"]


def test_ablations_take_back_one_idea_each_and_the_gain_is_the_defaults() -> None:
    shipped = Variant.named("layered")
    for variant in VARIANTS:
        taken_back = [
            variant.config.attributes != shipped.config.attributes,
            variant.settings != shipped.settings,
            not variant.weighted,
            not variant.measured,
        ]
        assert sum(taken_back) == 1, variant.name
    curve = [(4, 25), (7, 35), (10, 45)]
    lines = [line("layered", size, quality) for size, quality in curve]
    lines += [line("opacity as drawn", size, quality - 2) for size, quality in curve]
    (gain,) = gains(lines, "s", "layered")
    assert gain == {"scene": "s", "instead": "opacity as drawn", "default_gains_db": pytest.approx(2.0)}


def test_a_program_that_does_not_end_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(readers, "_LIMIT_S", 0.1)
    stuck = tmp_path / "node"
    stuck.write_text("#!/bin/sh\nexec sleep 5\n")
    stuck.chmod(0o755)
    with pytest.raises(ConfigError, match=r"took over 0\.1 s"):
        SplatTransform(str(stuck), tmp_path).read_ms(b"", ".spz", 1)
