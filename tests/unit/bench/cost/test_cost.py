"""The cost sweep: settings, measuring, comparing, plays, proposals and the page."""

import itertools
import math
import re
import tomllib
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_bench.cost.budget import propose, proposed, write_config
from cags_bench.cost.comparing import (
    beaten_by,
    beats,
    cost_ratio,
    default_of,
    gain,
    line,
    marginal_ms_per_db,
    neighbours,
    pareto,
    verdict,
)
from cags_bench.cost.correcting import correcting_stages
from cags_bench.cost.effects import IN_PART, WHOLE
from cags_bench.cost.engine import BEST_DB, Measured, Point, Stage, gathered, measure
from cags_bench.cost.moments import Moment, Workbench
from cags_bench.cost.page import write_page
from cags_bench.cost.plays import COSTS, Variant, choices, played
from cags_bench.cost.settings import CostSettings
from cags_bench.cost.sweep import checks_of
from cags_bench.sim.session import SessionResult
from cags_bench.sim.spent import Spent
from cags_common import raster
from cags_common.errors import ConfigError
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.raster import RenderOptions
from cags_encoder import EncodeSettings
from cags_encoder.scenes import open_scene
from cags_server.settings import ServerSettings

SIZE = "640x480"

NOISE = -0.1, 0.1, 0.0, 0.05, -0.05
"""What moments differ by."""


def group(
    quality: str,
    *points: tuple[str, float, float],
    default: str = "",
    name: str = "stage",
    size: str = "",
    costs: tuple[str, ...] = (),
) -> list[Measured]:
    """Points of one stage (label, ms, quality) at five moments; qualities and times differ from moment to moment."""
    stage = Stage(name, "knob", "client", quality, costs=costs)
    made = []
    for number, (label, ms, value) in enumerate(points):
        noise = [*NOISE[number % 5 :], *NOISE[: number % 5]]
        times = {at: [ms * (1 + 0.01 * own)] for at, own in enumerate(noise)}
        outcomes = {at: {quality: value + own} for at, own in enumerate(noise)}
        made.append(Measured(stage, label, label == default, size, times, outcomes))
    return made


def labels(front: list[Measured]) -> list[str]:
    return [one.label for one in front]


def test_scenes_are_separated_by_spaces_and_sizes_come_smallest_first():
    settings = CostSettings(scenes="a.ply procedural:size=9,frames=2  a.ply", sizes="1600x1200,640x480")
    assert settings.scene_list == ["a.ply", "procedural:size=9,frames=2"]
    assert settings.size_list == [(640, 480), (1600, 1200)]


@pytest.mark.parametrize("wrong", [{"scenes": " "}, {"sizes": "big"}, {"sizes": "640x480x3"}, {"sizes": "8x8"}])
def test_what_does_not_parse_is_refused_with_its_name(wrong):
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        CostSettings(**wrong)


def test_a_file_for_proposals_needs_a_budget():
    with pytest.raises(ConfigError, match="--budget-ms"):
        CostSettings(config_out="c.toml")


def test_points_run_in_rounds_after_one_that_is_judged():
    calls: list[str] = []
    points = tuple(Point(name, lambda name=name: calls.append(name), lambda _: {"psnr_db": 1.0}) for name in "ab")
    measured = measure([Stage("s", "k", "client", "psnr_db", points)], 7, SIZE, 2, lambda done, total: None)
    assert calls == ["a", "b", "a", "b", "a", "b"]
    assert [len(one.times_ms[7]) for one in measured] == [2, 2]


def test_what_takes_seconds_runs_once_and_that_is_timed():
    calls: list[str] = []
    steps: list[tuple[int, int]] = []
    point = Point("a", lambda: calls.append("a"), lambda _: {"psnr_db": 1.0})
    cold = Stage("s", "k", "encoder", "psnr_db", (point,), warm=False)
    (one,) = measure([cold], 0, SIZE, 5, lambda done, total: steps.append((done, total)))
    assert calls == ["a"]
    assert len(one.times_ms[0]) == 1
    assert steps == [(1, 1)]


def test_an_encoding_is_judged_at_several_moments():
    point = Point("a", lambda: 30.0, lambda db: [{"psnr_db": db}, {"psnr_db": db + 1}])
    (one,) = measure([Stage("s", "k", "encoder", "psnr_db", (point,), moments=(4, 5))], 4, "", 1, lambda *_: None)
    assert one.outcomes == {4: {"psnr_db": 30.0}, 5: {"psnr_db": 31.0}}
    assert list(one.times_ms) == [4]


def test_moments_are_gathered_by_stage_size_and_point():
    point = Point("a", lambda: None, lambda _: {"psnr_db": 1.0}, default=True)
    stage = Stage("s", "k", "client", "psnr_db", (point,))
    parts = [measure([stage], at, size, 2, lambda *_: None) for size in ("small", "large") for at in range(3)]
    small, large = gathered(parts)
    assert [(one.label, one.size, one.default) for one in (*small, *large)] == [
        ("a", "small", True),
        ("a", "large", True),
    ]
    assert sorted(small[0].outcomes) == [0, 1, 2]
    assert len(small[0].all_times_ms) == 6


def test_the_front_leaves_out_what_is_slower_and_no_better():
    points = group("psnr_db", ("fast", 1, 30), ("bad", 2, 29), ("good", 3, 35), ("same", 4, 35))
    assert labels(pareto(points)) == ["fast", "good"]


def test_for_errors_less_is_better():
    points = group("error_deg", ("hold", 1, 7.6), ("linear", 2, 5.1), ("worse", 3, 6.0))
    assert labels(pareto(points)) == ["hold", "linear"]
    assert verdict(gain(points[1], points[0])) == "better"


def test_of_two_equally_fast_points_the_better_one_stands():
    assert labels(pareto(group("psnr_db", ("a", 1, 30), ("b", 1.0001, 31), ("c", 1.0002, 30.5)))) == ["a", "b"]


def test_one_more_db_has_a_price():
    front = pareto(group("psnr_db", ("fast", 1, 30), ("good", 4, 36)))
    ((cheap, dear, ms),) = marginal_ms_per_db(front)
    assert (cheap, dear) == ("fast", "good")
    assert ms == pytest.approx(0.5, rel=0.01)
    assert marginal_ms_per_db(pareto(group("coverage", ("a", 1, 0.5), ("b", 2, 0.9)))) == []


def test_a_gain_within_the_noise_of_the_moments_is_called_nothing():
    default, same, better, worse = group("psnr_db", ("d", 1, 30), ("s", 1, 30.01), ("b", 1, 31), ("w", 1, 29))
    assert [verdict(gain(one, default)) for one in (same, better, worse)] == ["", "better", "worse"]


def test_gains_are_paired_by_moment_and_one_moment_is_sure_of_nothing():
    default, other = group("psnr_db", ("d", 1, 30), ("o", 1, 31))
    for at, scene_db in enumerate((0, 20, 5, 10, 3)):  # moments differ by far more than the points do
        default.outcomes[at]["psnr_db"] += scene_db
        other.outcomes[at]["psnr_db"] += scene_db
    assert gain(other, default).mean == pytest.approx(1)
    assert verdict(gain(other, default)) == "better"
    other.outcomes = {4: other.outcomes[4]}
    assert verdict(gain(other, default)) == ""


def test_a_default_is_beaten_only_where_quality_and_every_cost_are_surely_no_worse():
    points = group("psnr_db", ("shipped", 2, 31), ("good", 1, 35), ("fast", 1, 31), default="shipped", costs=("bytes",))
    shipped, good, fast = points
    for one, size in zip(points, (100, 100, 100), strict=True):
        one.outcomes = {at: outcome | {"bytes": size} for at, outcome in one.outcomes.items()}
    assert beaten_by(points) == [good]  # the fast one may be worse, for all that is known
    fast.outcomes = shipped.outcomes
    assert beaten_by(points) == [good, fast]  # equal at every moment, and faster
    good.outcomes = {at: outcome | {"bytes": 101} for at, outcome in good.outcomes.items()}
    assert beaten_by(points) == [fast]
    assert beaten_by([good, replace(shipped, default=False)]) == []


def test_costs_that_are_zero_compare_with_nothing():
    default, none = group("psnr_db", ("d", 2, 31), ("none", 1, 35), costs=("bytes",))
    for one, size in ((default, 0), (none, 0)):
        one.outcomes = {at: outcome | {"bytes": size} for at, outcome in one.outcomes.items()}
    assert math.isnan(cost_ratio(none, default, "bytes").mean)
    assert not beats(none, default)


def test_the_defaults_neighbours_are_the_next_on_the_front():
    points = group(
        "psnr_db",
        ("half", 1, 25),
        ("low", 2, 29),
        ("bad", 2.5, 20),
        ("shipped", 3, 31),
        ("x", 4, 33),
        default="shipped",
    )
    assert [one.label for one in neighbours(points) if one] == ["low", "x"]
    assert neighbours(points[:1]) == (None, None)


values = st.lists(st.floats(-50, 50), min_size=2, max_size=8)


@given(ours=values, theirs=values, ms=st.tuples(st.floats(0.1, 9), st.floats(0.1, 9)))
def test_two_points_never_beat_each_other_and_gains_are_opposite(ours, theirs, ms):
    stage = Stage("s", "k", "client", "psnr_db")
    a, b = (
        Measured(
            stage, "", times_ms=dict(enumerate([[t] for _ in q])), outcomes=dict(enumerate({"psnr_db": x} for x in q))
        )
        for q, t in zip((ours, theirs), ms, strict=True)
    )
    assert not (beats(a, b) and beats(b, a))
    assert not beats(a, a)
    assert gain(a, b).mean == pytest.approx(-gain(b, a).mean, nan_ok=True)
    assert {verdict(gain(a, b)), verdict(gain(b, a))} in ({""}, {"better", "worse"})


@given(st.lists(st.tuples(st.floats(0.1, 9), st.floats(0, 60)), min_size=1, max_size=8))
def test_every_point_off_the_front_has_one_on_it_that_is_no_slower_and_no_worse(points):
    every = group("psnr_db", *((str(at), ms, db) for at, (ms, db) in enumerate(points)))
    front = pareto(every)
    assert all(a.median_ms <= b.median_ms and a.quality < b.quality for a, b in itertools.pairwise(front))
    for one in every:
        assert any(f.median_ms <= one.median_ms and f.quality >= one.quality for f in front)


def test_a_line_compares_with_the_default():
    points = group("psnr_db", ("shipped", 2, 31), ("fast", 1, 30), default="shipped", size=SIZE)
    own, other = (line(one, default_of(points)) for one in points)
    assert "gain" not in own
    assert own["quality_low"] < own["psnr_db"] < own["quality_high"]
    assert (other["verdict"], other["observations"], other["runs"]) == ("worse", 5, 5)
    assert other["times_low"] < 0.5 < other["times_high"]


def test_every_stage_of_sessions_has_its_default_once():
    for (name, _), of in choices().items():
        assert [variant == Variant() for variant in of.values()].count(True) == 1, name


def test_a_default_that_is_changed_is_still_a_choice(monkeypatch):
    changed = replace(ServerSettings(), lead_frames=7, reference_width=320, reference_crf=18.5)
    monkeypatch.setattr("cags_bench.cost.plays.ServerSettings", lambda: changed)
    monkeypatch.setattr("cags_bench.cost.plays.EncodeSettings", lambda: replace(EncodeSettings(), motion="none"))
    found = {knob: list(of) for (_, knob), of in choices().items()}
    assert found["lead_frames"] == ["7", "2", "4", "6", "8"]
    assert "320x300" in found["width x height"]
    assert "18.5" in found["reference_crf"]
    assert choices()["session: motion", "motion"]["none"].encode.motion == "none"


def test_a_session_is_judged_in_parts_of_frames():
    def frame(at):
        return {
            "psnr_covered_restored_db": math.nan if at == 0 else math.inf if at == 1 else 30.0 + (at >= 9),
            "flicker_restored": None if at == 0 else 2.0,
            "bytes_tiles": 900,
            "bytes_reference": 100,
        }

    spent = Spent(serving_ms=18.0, decoding_ms=36.0, presenting_ms=54.0, frames=18)
    found = played(SessionResult([frame(at) for at in range(18)], {}, spent))
    assert [part["psnr_covered_db"] for part in found.parts] == [pytest.approx((BEST_DB + 7 * 30) / 8), 31.0]
    assert all(part["kb_a_frame"] == pytest.approx(1.0) and part["flicker"] == 2.0 for part in found.parts)
    assert {*COSTS, "server_ms", "client_ms"} <= set(found.parts[0])
    assert found.spent_ms == pytest.approx(1 + 2 + 3)


def test_where_a_reference_has_nothing_to_say_the_clients_own_picture_stays(tmp_path):
    source = open_scene("procedural:size=500,frames=1")
    splats, rasteriser = source.frame(0), raster.create("auto")
    eye = tuple(c + 2 * source.focus.radius for c in source.focus.centre)
    camera = Camera(Intrinsics.of_fov(64, 48, 1.0, 0.8), Pose.looking_at(eye, source.focus.centre, source.up))
    scene = rasteriser.load(splats)
    truth = scene.render(camera, RenderOptions()).rgb.clip(0, 1)
    moment = Moment(0, camera, camera, scene, rasteriser.load(splats), 1.0, truth, splats)
    stages = correcting_stages(Workbench(tmp_path, 0, "synthetic:walking", (moment,)))
    found = measure(stages, 0, SIZE, 1, lambda *_: None)
    by_stage = {(one.stage.name, one.label): one.quality for one in found}
    for method in ("none", "correct, difference"):
        assert by_stage["correction", method] > 90
    for method in ("none", "correct"):
        assert by_stage["client frame", f"balanced / full / {method}"] > 90


def frames_at(size: str, *points: tuple[str, float, float]) -> list[Measured]:
    return group("corrected_psnr_db", *points, name="client frame", size=size)


SERVER = group(
    "corrected_psnr_db",
    ("200x150 / crf 28", 2, 26),
    ("400x300 / crf 20", 6, 28),
    ("800x600 / crf 16", 30, 29),
    name="whole reference",
    size=SIZE,
)
FRAMES = frames_at(
    SIZE,
    ("fast / half / none", 5, 25),
    ("balanced / full / correct", 12, 30),
    ("exact / full / correct", 40, 31),
)


def test_the_proposal_is_the_best_that_fits_with_headroom(tmp_path):
    chosen = propose(FRAMES, SERVER, 16.7)
    assert (chosen.client.label, chosen.server.label) == ("balanced / full / correct", "400x300 / crf 20")
    assert propose(FRAMES, SERVER, 60).client.label == "exact / full / correct"
    write_config(tmp_path / "c.toml", chosen, CostSettings(budget_ms=16.7))
    assert tomllib.loads((tmp_path / "c.toml").read_text()) == {
        "client": {"width": 640, "height": 480, "exactness": "balanced", "resolution": "full", "restore": "correct"},
        "server": {"reference_width": 400, "reference_height": 300, "reference_crf": 20.0},
    }


def test_the_proposal_is_for_the_largest_size_at_which_something_fits():
    large = frames_at("1600x1200", ("fast / half / none", 30, 25), ("exact / full / correct", 250, 31))
    served = group("corrected_psnr_db", ("400x300 / crf 20", 6, 28), name="whole reference", size="1600x1200")
    every = [FRAMES, SERVER, large, served]
    assert proposed(every, 50).client.size == "1600x1200"
    assert proposed(every, 50).client.label == "fast / half / none"
    assert proposed(every, 20).client.size == SIZE
    with pytest.raises(ConfigError, match=rf"budget_ms = 1.*5\.0 ms at {SIZE}.*--sizes"):
        proposed(every, 1)


def test_client_and_server_both_accept_the_one_file(tmp_path):
    import argparse

    from cags_client.settings import ClientSettings
    from cags_common.settings import add_settings, load_settings
    from cags_server.settings import ServeSettings

    write_config(tmp_path / "c.toml", propose(FRAMES[:1], SERVER[:1], 16.7), CostSettings(budget_ms=16.7))

    def loaded(settings, *more):
        parser = argparse.ArgumentParser()
        add_settings(parser, settings)
        return load_settings(settings, parser.parse_args(["--config", str(tmp_path / "c.toml"), *more]))

    client, server = loaded(ClientSettings), loaded(ServeSettings, "--bundle", "somewhere")
    assert (client.exactness, client.resolution, client.restore, client.width) == ("fast", "half", "none", 640)
    assert (server.reference_width, server.reference_height, server.reference_crf) == (200, 150, 28.0)


def effects(needed_ms: float, outside_ms: float = 0.1) -> list[list[Measured]]:
    found = []
    for name in (IN_PART, WHOLE):
        points = ("needed", needed_ms, 30), ("always", 10, 30)
        made = group("corrected_psnr_db", *points, default="needed", name=name)
        for one in made:
            one.outcomes = {key: outcome | {"outside_ms": outside_ms} for key, outcome in one.outcomes.items()}
        found.append(made)
    return found


def test_checks_name_stages_without_a_default_and_defaults_that_are_beaten():
    lost = group("psnr_db", ("a", 1, 30), ("b", 2, 31), name="lost", size=SIZE)
    beaten = group("psnr_db", ("good", 1, 35), ("shipped", 2, 31), default="shipped", name="beaten", size=SIZE)
    sound = group("psnr_db", ("fast", 1, 30), ("shipped", 2, 31), default="shipped", name="sound")
    checks = {one["name"]: one for one in checks_of([lost, beaten, sound, *effects(9)])}
    assert {one["value"][0] for one in checks.values() if isinstance(one["value"], list)} == {
        f"lost at {SIZE}",
        f"beaten at {SIZE} (good)",
    }
    assert [one["ok"] for one in checks.values()] == [False, False, True, True]
    assert all(one["ok"] for one in checks_of([sound, *effects(9)]))
    assert [one["ok"] for one in checks_of([sound, *effects(11, 2.0)])] == [True, True, False, False]


def test_the_page_shows_every_point_with_its_gain_and_escapes(tmp_path):
    small = group("psnr_db", ("<fast>", 1, 30), ("good", 3, 35), default="good", name="render", size=SIZE)
    large = group("psnr_db", ("<fast>", 4, 29), ("good", 9, 35), default="good", name="render", size="1600x1200")
    settings = CostSettings(scenes="<script>", sizes="640x480,1600x1200")
    write_page(tmp_path, [small, large], checks_of([small, large, *effects(9)]), settings)
    page = (tmp_path / "index.html").read_text()
    assert "&lt;fast&gt;" in page
    assert "class=default" in page
    assert "<script>" not in page
    assert re.search(r"-5 \[-5\.\d+, -4\.\d+\] worse", page)
    assert page.index("What the defaults cost") < page.index("<h2>render")
    assert page.count("<img") == 2
    rows = (tmp_path / "points.csv").read_text().splitlines()
    assert len(rows) == 5
    assert "gain_low" in rows[0]
