"""The cost sweep: fronts, marginal costs, proposals and the page."""

import tomllib

import pytest

from cags_bench.cost.budget import propose, write_config
from cags_bench.cost.engine import Measured, Point, Stage, marginal_ms_per_db, measure, pareto
from cags_bench.cost.page import write_page
from cags_bench.cost.settings import CostSettings
from cags_common.errors import ConfigError


def stage(quality: str, *points: tuple[str, float, float], default: str = "") -> list[Measured]:
    made = tuple(Point(label, lambda: None, lambda _: {}, default=label == default) for label, _, _ in points)
    owner = Stage("client frame", "knob", "client", quality, made)
    return [Measured(owner, p, [ms], {quality: q}) for p, (_, ms, q) in zip(made, points, strict=True)]


def labels(front: list[Measured]) -> list[str]:
    return [one.point.label for one in front]


def test_the_front_leaves_out_what_is_slower_and_no_better():
    group = stage("psnr_db", ("fast", 1, 30), ("bad", 2, 29), ("good", 3, 35), ("same", 4, 35))
    assert labels(pareto(group)) == ["fast", "good"]


def test_for_errors_less_is_better():
    group = stage("error_deg", ("hold", 1, 7.6), ("linear", 2, 5.1), ("worse", 3, 6.0))
    assert labels(pareto(group)) == ["hold", "linear"]


def test_of_two_equally_fast_points_the_better_one_stands():
    assert labels(pareto(stage("psnr_db", ("a", 1, 30), ("b", 1, 31)))) == ["b"]


def test_one_more_db_has_a_price():
    front = pareto(stage("psnr_db", ("fast", 1, 30), ("good", 4, 36)))
    assert marginal_ms_per_db(front) == [("fast", "good", 0.5)]
    assert marginal_ms_per_db(pareto(stage("coverage", ("a", 1, 0.5), ("b", 2, 0.9)))) == []


def test_points_run_in_rounds_after_one_warm_up():
    calls: list[str] = []
    points = tuple(Point(name, lambda name=name: calls.append(name), lambda _: {"psnr_db": 1.0}) for name in "ab")
    measured = list(measure([Stage("s", "k", "client", "psnr_db", points, repetitions=2)], lambda done, total: None))
    assert calls == ["a", "b", "a", "b", "a", "b"]
    assert [len(one.times_ms) for one in measured] == [2, 2]


SERVER = stage(
    "corrected_psnr_db", ("200x150 / crf 28", 2, 26), ("400x300 / crf 20", 6, 28), ("800x600 / crf 16", 30, 29)
)


def test_the_proposal_is_the_best_that_fits_with_headroom(tmp_path):
    frames = stage(
        "corrected_psnr_db",
        ("fast / half / none", 5, 25),
        ("balanced / full / correct", 12, 30),
        ("exact / full / correct", 40, 31),
    )
    chosen = propose(frames, SERVER, 16.7)
    assert (chosen.client.point.label, chosen.server.point.label) == ("balanced / full / correct", "400x300 / crf 20")
    assert propose(frames, SERVER, 60).client.point.label == "exact / full / correct"
    write_config(tmp_path / "c.toml", chosen, CostSettings(budget_ms=16.7))
    assert tomllib.loads((tmp_path / "c.toml").read_text()) == {
        "client": {"width": 800, "height": 600, "exactness": "balanced", "resolution": "full", "restore": "correct"},
        "server": {"reference_width": 400, "reference_height": 300, "reference_crf": 20.0},
    }


def test_client_and_server_both_accept_the_one_file(tmp_path):
    import argparse

    from cags_client.settings import ClientSettings
    from cags_common.settings import add_settings, load_settings
    from cags_server.settings import ServeSettings

    chosen = propose(stage("corrected_psnr_db", ("fast / half / none", 5, 25)), SERVER[:1], 16.7)
    write_config(tmp_path / "c.toml", chosen, CostSettings(budget_ms=16.7))

    def loaded(settings, *more):
        parser = argparse.ArgumentParser()
        add_settings(parser, settings)
        return load_settings(settings, parser.parse_args(["--config", str(tmp_path / "c.toml"), *more]))

    client, server = loaded(ClientSettings), loaded(ServeSettings, "--bundle", "somewhere")
    assert (client.exactness, client.resolution, client.restore, client.width) == ("fast", "half", "none", 800)
    assert (server.reference_width, server.reference_height, server.reference_crf) == (200, 150, 28.0)


def test_a_budget_that_nothing_fits_is_refused_with_the_way_out():
    with pytest.raises(ConfigError, match=r"budget_ms = 1.*5\.0 ms"):
        propose(stage("corrected_psnr_db", ("fast / half / none", 5, 25)), SERVER, 1)


def test_the_page_shows_every_point_and_escapes(tmp_path):
    group = stage("psnr_db", ("<fast>", 1, 30), ("good", 3, 35), default="good")
    write_page(tmp_path, [group], CostSettings(scene="<script>"))
    page = (tmp_path / "index.html").read_text()
    assert "&lt;fast&gt;" in page
    assert "class=default" in page
    assert "<script>" not in page
    assert len((tmp_path / "points.csv").read_text().splitlines()) == 3
