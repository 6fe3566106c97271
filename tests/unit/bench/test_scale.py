"""Servers behind a balancer: what they carry, and that overload and death show."""

from __future__ import annotations

import json
from argparse import ArgumentParser
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from cags_bench.scale.cluster import Cluster, Load
from cags_bench.scale.command import _curve_checks, add_arguments, capacity, run
from cags_bench.scale.settings import ScaleSettings
from cags_bench.scale.sizing import judged, sizing_caption, sizing_table
from cags_bench.scale.viewers import ALONE, APART, SAME, Audience, cost_of, splats_shown
from cags_bench.sim.workers import Cores
from cags_common.errors import ConfigError
from cags_encoder import EncodeSettings, encode
from cags_encoder.scenes import open_scene

ROOT = Path(__file__).parents[3]

LOAD = Load(4, job_ms=20.0, workers=2, seconds=6.0, stay_s=5.0)
IDEAL = 2 * 50 / 30  # sessions a server


def test_a_light_load_is_served_whole_and_runs_are_the_same() -> None:
    outcome = Cluster(2, LOAD).run()
    assert outcome.share > 0.99
    assert outcome.due > 4 * 30 * 3
    again = Cluster(2, LOAD).run()
    assert (again.due, again.on_time) == (outcome.due, outcome.on_time)


def test_an_overload_is_not_carried() -> None:
    crowd = Cluster(1, replace(LOAD, sessions=12)).run()
    assert crowd.share < 0.6
    assert crowd.on_time <= 2 * 50 * 6  # no more than the renderers can do
    assert crowd.due - 12 * 2 <= crowd.on_time + crowd.late <= crowd.due  # all but what is under way at the end


def test_nothing_is_late_where_a_server_idles() -> None:
    steady = replace(LOAD, sessions=2, stay_s=1e4)
    assert Cluster(1, steady).run().late == 0


def test_capacity_is_near_what_the_renderers_can_do_and_grows_with_the_servers() -> None:
    steady = replace(LOAD, stay_s=1e4)
    one, four = capacity(1, steady), capacity(4, steady)
    assert one == int(IDEAL)
    assert four >= 4 * one


def test_a_dead_server_s_sessions_go_on_elsewhere() -> None:
    light = replace(LOAD, sessions=3, stay_s=1e4)
    whole, broken = Cluster(2, light).run(), Cluster(2, light).run(kill_at_s=3.0)
    missing = whole.on_time - broken.on_time
    assert 0 < missing <= 3 * 30 * 0.5 + 10  # at most half a second of each
    alone = Cluster(1, light).run(kill_at_s=3.0)
    assert alone.on_time < 0.6 * whole.on_time


def test_the_command_tells_the_curve(tmp_path) -> None:  # type: ignore[no-untyped-def]
    parser = ArgumentParser()
    add_arguments(parser)
    flags = ["--job-ms", "18", "--servers", "3", "--seconds", "5", "--plot", str(tmp_path / "curve.png")]
    *lines, last = run(parser.parse_args(flags))
    assert [line["servers"] for line in lines] == [1, 2, 3, 3]
    assert set(last["curve"]) == {"1", "2", "3"}
    assert [entry["name"] for entry in last["checks"]]
    assert (tmp_path / "curve.png").stat().st_size > 1000


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scale") / "clip.cags"
    settings = EncodeSettings(frames=24)
    encode(open_scene("procedural:size=600,frames=24"), settings, str(folder))
    return folder


def test_viewers_cost_what_their_sessions_take(bundle: Path) -> None:
    both = {
        sharing: cost_of(Audience(bundle, 2, 5.0, sharing, width=80, height=60).played(1))
        for sharing in (SAME, APART, ALONE)
    }
    for cost in both.values():
        assert min(cost.truth_ms, cost.mirror_ms, cost.coding_ms, cost.serving_ms, cost.mirror_mb) > 0
        assert 25 < cost.jobs < 35  # 30 frames a second, and a reference for each
    assert len({cost.missed for cost in both.values()}) == 1  # what is shared changes nothing that is shown
    unreferenced = cost_of(Audience(bundle, 2, 5.0, references="none", width=80, height=60).played(1))
    assert unreferenced.mirror_mb == 0
    assert unreferenced.mirror_ms < both[SAME].mirror_ms / 10
    assert unreferenced.jobs < both[SAME].jobs / 2


def test_splats_are_not_counted_again_where_they_move(bundle: Path) -> None:
    assert 500 <= splats_shown(bundle) <= 600


def test_the_whole_command_tells_costs_and_uses_them(bundle: Path, tmp_path: Path) -> None:
    parser = ArgumentParser()
    add_arguments(parser)
    flags = ["--scene", str(bundle), "--viewers", "1", "--rounds", "1", "--crowd", "2", "--servers", "1"]
    *lines, last = run(parser.parse_args([*flags, "--seconds", "5", "--table", str(tmp_path / "table.md")]))
    assert [line["case"] for line in lines] == ["viewers"] * 5 + ["crowd", "servers"]
    assert last["job_ms"] == lines[0]["job_ms"]
    names = [entry["name"] for entry in last["checks"]]
    assert any("viewers a core at 5 Mbps" in name for name in names)
    assert any("2 viewers at 5 frames a second and 3 Mbps" in name for name in names)
    *_, blank, caption = (tmp_path / "table.md").read_text().splitlines()
    assert blank == ""
    assert f"commit {last['commit']}" in caption


def test_on_cores_that_are_too_few_everybody_gets_a_share(bundle: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The work takes time there: 60 ms a reference, where three viewers want one every 11 ms."""
    whole = Audience(bundle, 3, 5.0, width=80, height=60)
    alone = [len(one.spent.references) for one in whole.played(1)]
    taken = Cores.taken_until_us
    monkeypatch.setattr(Cores, "taken_until_us", lambda cores, now_us, took_us: taken(cores, now_us, 60_000.0))
    shared = [len(one.spent.references) for one in replace(whole, cores=1).played(1)]
    seconds = 24 / 30
    assert max(shared) < min(alone) / 2
    assert sum(shared) >= 0.8 * seconds / 0.06
    assert min(shared) >= 0.5 * max(shared) - 2


def test_a_clip_that_is_too_short_says_so(bundle: Path) -> None:
    results = Audience(bundle, 1, 5.0, width=80, height=60).played(1)
    results[0].spent.playing = None
    with pytest.raises(ConfigError, match="give more frames"):
        cost_of(results)


def test_sizes_are_numbers() -> None:
    with pytest.raises(ConfigError, match="'many' is not a number of splats"):
        ScaleSettings(sizes="1000,many")


def way(sharing: str, references: str, cpu_ms: float) -> dict[str, Any]:
    parts = dict.fromkeys(("truth_ms", "mirror_ms", "coding_ms", "serving_ms"), cpu_ms / 4)
    return {
        "case": "viewers", "scene": "procedural:size=1000", "splats": 1000, "sharing": sharing, "mbps": 5.0,
        "references": references, "cpu_ms": cpu_ms, "viewers_a_core": round(800 / cpu_ms, 2), "mirror_mb": 1.0, **parts,
    }  # fmt: skip


def ways(same_ms: float, alone_ms: float) -> list[dict[str, Any]]:
    auto = [way(SAME, "auto", same_ms), way(APART, "auto", same_ms), way(ALONE, "auto", alone_ms)]
    return [*auto, way(SAME, "picture", 200.0), way(SAME, "none", 100.0)]


def test_checks_say_what_is_not_carried() -> None:
    crowd: dict[str, Any] = {
        "case": "crowd", "viewers": 20, "fps": 5.0, "mbps": 3.0, "cores": 1.7, "on_cores": 2, "missed": [0, 1, 0],
        "missed_alone": 0, "late": [0, 2, 0], "references_of_a_viewer": [[9, 10], [4, 10]],
    }  # fmt: skip
    assert not any(entry["ok"] for entry in judged([*ways(900.0, 800.0), crowd]))
    crowd |= {"cores": 1.5, "missed": [0], "late": [0, 0, 0], "references_of_a_viewer": [[9, 10], [5, 10]]}
    good = judged([*ways(400.0, 500.0), crowd])
    assert len(good) == 7
    assert all(entry["ok"] for entry in good)


def test_the_table_has_a_row_a_scene() -> None:
    *_, row = sizing_table(ways(400.0, 500.0)).splitlines()
    assert row == "| 1,000 | 400 | 400 | 500 | 100 + 100 + 100 + 100 | 2.0 | 4.0 | 8.0 | 1.6 | 1.0 |"


def test_the_operators_table_is_that_of_the_committed_lines() -> None:
    folder = ROOT / "docs/how-to"
    lines = [json.loads(line) for line in (folder / "sizing.jsonl").read_text(encoding="utf-8").splitlines()]
    cases, page = [line for line in lines if "case" in line], (folder / "operate.md").read_text("utf-8")
    assert f"{sizing_table(cases)}\n{sizing_caption(cases, lines[-1])}\n" in page, "the output of --table, as it is"


def test_one_server_is_not_compared_with_itself() -> None:
    """The check could not fail."""
    assert _curve_checks({1: 40}, {}) == []
    [one] = _curve_checks({1: 40, 2: 60}, {})
    assert (one["value"], one["ok"]) == (0.75, False)
    [none] = _curve_checks({1: 0, 2: 0}, {})
    assert not none["ok"]
