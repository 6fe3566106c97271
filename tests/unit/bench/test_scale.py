"""Servers behind a balancer: what they carry, and that overload and death show."""

from __future__ import annotations

from argparse import ArgumentParser
from dataclasses import replace

from cags_bench.scale.cluster import Cluster, Load
from cags_bench.scale.command import add_arguments, capacity, run

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
    flags = ["--servers", "3", "--seconds", "5", "--plot", str(tmp_path / "curve.png")]
    *lines, last = run(parser.parse_args(flags))
    assert [line["servers"] for line in lines] == [1, 2, 3, 3]
    assert set(last["curve"]) == {"1", "2", "3"}
    assert [entry["name"] for entry in last["checks"]]
    assert (tmp_path / "curve.png").stat().st_size > 1000
