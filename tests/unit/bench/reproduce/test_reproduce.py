"""Reproductions: chosen by name, resumed by content, written as pages and data."""

import json
from dataclasses import replace

import pytest

from cags_bench.jsonl import check, dump
from cags_bench.reproduce.cache import ResultCache
from cags_bench.reproduce.cases import Runner, StreamCase
from cags_bench.reproduce.experiments import EXPERIMENTS
from cags_bench.reproduce.experiments.coding import _against
from cags_bench.reproduce.marking import marked, titles
from cags_bench.reproduce.methods import ABLATIONS, BASELINES, METHODS
from cags_bench.reproduce.page import write_page, write_section
from cags_bench.reproduce.plan import Context, Plan
from cags_bench.reproduce.prepare import _quick, _short, prepare
from cags_bench.reproduce.run import reproduce
from cags_bench.reproduce.section import Curve, Plot, Section
from cags_bench.reproduce.settings import ReproduceSettings
from cags_bench.reproduce.stills.published import DATASETS
from cags_bench.traces import scaled_trace, steepest_fall_s
from cags_common.errors import ConfigError
from cags_shaper.trace import open_trace

PLAN = Plan(("a",), "synthetic:still", "generated:steady-5", 8, 64, 48, quick=True)


def test_a_result_is_computed_once(tmp_path):
    cache, calls = ResultCache(tmp_path), []

    def compute() -> dict:
        calls.append(1)
        return {"psnr": 30.0}

    assert cache.get({"a": 1}, compute) == cache.get({"a": 1}, compute) == {"psnr": 30.0}
    assert cache.get({"a": 2}, compute) == {"psnr": 30.0}
    assert len(calls) == 2


def test_an_interrupted_result_is_not_kept(tmp_path):
    def fail() -> dict:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ResultCache(tmp_path).get({"a": 1}, fail)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (ReproduceSettings(), "nothing is asked for"),
        (ReproduceSettings(table="fixed"), r"table = 'fixed' is unknown; known: svq, rivals, sessions"),
        (ReproduceSettings(figure="none"), "figure = 'none' is unknown; known: motivation"),
        (ReproduceSettings(table="rivals", methods="cags lts"), "methods: 'lts' is unknown; known: cags"),
        (ReproduceSettings(table="rivals", links="30 fast"), "must be numbers"),
        (ReproduceSettings(table="rivals", links="30 -1"), "must be above 0"),
        (ReproduceSettings(figure="fixed", page="nowhere.md"), "nowhere.md: cannot be read"),
        (ReproduceSettings(figure="fixed", kept=True), "kept = true is for --table sessions or rivals"),
    ],
)
def test_unknown_names_are_refused(settings, message):
    with pytest.raises(ConfigError, match=message):
        list(reproduce(settings))


def test_every_method_says_what_stands_in():
    assert {"cags", "cags-paper", *BASELINES, *ABLATIONS} == set(METHODS)
    assert all(method.note for method in METHODS.values())


def test_every_experiment_is_a_table_or_a_figure():
    assert {one.kind for one in EXPERIMENTS.values()} == {"table", "figure"}


def test_scaled_traces_keep_their_shape(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    scaled = open_trace(str(scaled_trace("generated:step", 0.5, seconds=20)))
    whole = open_trace("generated:step")
    for start in range(0, 20_000_000, 2_000_000):
        expected = whole.mean_bps(start, start + 2_000_000) / 2
        assert scaled.mean_bps(start, start + 2_000_000) == pytest.approx(expected, rel=0.05, abs=20_000)


def test_a_clip_gets_the_steepest_fall_of_a_trace(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    spec = tmp_path / "link.csv"
    rates = [100, 90, 100, 100, 2, 3, 50, 60, 40, 50]
    spec.write_text("time_s,mbps\n" + "".join(f"{second},{mbps}\n" for second, mbps in enumerate(rates)))
    start = steepest_fall_s(str(spec), 2.0)
    assert start == 3.0
    part = open_trace(str(scaled_trace(str(spec), 1.0, 4, start)))
    assert part.mean_bps(0, 1_000_000) == pytest.approx(100e6, rel=0.02)
    assert part.mean_bps(1_000_000, 2_000_000) == pytest.approx(2e6, rel=0.05)
    case = StreamCase("procedural:size=500,frames=2", "cags", "synthetic:still", 30, 64, 48, str(spec), unscaled=True)
    assert open_trace(case.link(tmp_path)).mean_bps(0, 1_000_000) == pytest.approx(100e6, rel=0.02), "as recorded"


def test_page_and_data_hold_the_section(tmp_path):
    section = Section(
        "fixed",
        "Quality <under> load",
        "Figure",
        columns=("method", "PSNR [dB]"),
        rows=[["ours", 31.25], ["theirs", None]],
        plots=[Plot("t", "x", "y", [Curve("ours", [1, 2], [3, 4])])],
        checks=[check("ahead", "> 0", 1.0, ok=True)],
    )
    write_section(tmp_path, section)
    write_page(tmp_path, [section], PLAN)
    page = (tmp_path / "index.html").read_text()
    assert "Quality &lt;under&gt; load" in page
    assert "31.25" in page
    assert page.index("1 of 1 claims hold") < page.index("Quality &lt;under&gt; load"), "the summary comes first"
    assert "data:image/png;base64," in page
    lines = [json.loads(line) for line in (tmp_path / "fixed.jsonl").read_text().splitlines()]
    assert [line["PSNR [dB]"] for line in lines] == [31.25, None]
    assert len((tmp_path / "fixed.csv").read_text().splitlines()) == 3


def test_rows_of_what_was_trained_on_are_marked():
    seen, unseen = "shared/plant.splat", "new/violin.ply"
    plan = replace(PLAN, scenes=(seen, unseen), poses="walks/room_user13.csv", trace="links/lte.csv")
    section = Section(
        "x", "X", "p", ("scene", "dB"), [[seen, 1.0], [f"{unseen}, default", 2.0], [f"paper-66, {seen}", 3.0]]
    )
    found = marked(section, plan)
    assert [row[0] for row in found.rows] == ["plant †", "violin, default", "paper-66, plant †"]
    assert len(found.notes) == 1
    assert "† plant was seen before: " in found.notes[0]
    assert "training of srresnet" in found.notes[0]
    assert len(marked(section, PLAN).notes) == 2, "walk and trace"


def test_scenes_have_names_for_people_wherever_they_stand():
    room, head = "procedural:size=30000,frames=45", "../shared/scenes/talking_head/params.npz:up=y"
    curves = [Curve(f"{room}, default", [1], [2])]
    section = Section("x", "X", "p", ("scene",), [[room]], [Plot(head, "x", "y", curves)])
    section = replace(section, checks=[check("ahead", "> 0", f"least on {head}, 60 Mbps", ok=True)])
    found = marked(section, replace(PLAN, scenes=(room, head)))
    assert found.rows[0][0] == "room of 30,000 splats †"
    assert found.plots[0].title == "talking head"
    assert found.plots[0].curves[0].label == "room of 30,000 splats, default"
    assert found.checks[0]["value"] == "least on talking head, 60 Mbps"
    twins = ("a/wave", "b/wave")
    assert titles(twins) == dict(zip(twins, twins, strict=True)), "one name for two scenes is none"


@pytest.mark.parametrize("name", METHODS)
def test_methods_are_configurations_that_the_program_accepts(name):
    from cags_client.frame import align, restore
    from cags_client.settings import ClientSettings
    from cags_encoder import EncodeSettings
    from cags_server.fov import create_fov_policy
    from cags_server.ratecontrol import create_rate_policy
    from cags_server.settings import ServerSettings

    method = METHODS[name]
    server, client = ServerSettings(**method.server), ClientSettings(**method.client)
    EncodeSettings(**method.encode)
    align.create(client.align)
    restore.check_name(client.restore)
    create_rate_policy(server.abr)
    create_fov_policy(server.fov)


def test_the_published_way_has_pictures_drawn_plainly_and_restored_by_the_network():
    published, without = METHODS["cags-paper"], METHODS["no-prpa"]
    assert published.server["references"] == "picture"
    assert published.server["reference_footprint"] == "plain"
    assert published.client["restore"] == "srresnet"
    assert {k: v for k, v in without.client.items() if k != "align"} == published.client
    assert (without.server, without.encode) == (published.server, published.encode), "one part differs"


def test_keys_follow_content_and_configuration(tmp_path):
    case = StreamCase("procedural:size=500,frames=2", "cags", "synthetic:still", 2, 64, 48, "generated:steady-5")
    key = case.key("cpu")
    assert key == replace(case).key("cpu")
    assert key != case.key("oracle")
    assert key != replace(case, method="no-prpa").key("cpu")
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(METHODS, "cags", replace(METHODS["cags"], note="in other words"))
        assert key == case.key("cpu"), "a session is not played again for a word"
        patch.setitem(METHODS, "cags", replace(METHODS["cags"], predicted=True))
        assert key != case.key("cpu")
    walk = tmp_path / "walk.csv"
    walk.write_text("one")
    before = replace(case, poses=str(walk)).key("cpu")
    walk.write_text("two")
    assert replace(case, poses=str(walk)).key("cpu") != before


def test_prepared_cases_are_those_that_a_single_process_computes(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    one = StreamCase("procedural:size=500,frames=2", "cags", "synthetic:still", 2, 64, 48, "generated:steady-5", 60.0)
    cases = [one, replace(one, method="reference-only"), one]
    told: list[str] = []
    side_by_side, alone = (Runner(ResultCache(tmp_path / name)) for name in ("pool", "alone"))
    prepare(side_by_side, cases, 2, told.append)
    assert len(told) == 3, "one encoding, two sessions"
    assert all(side_by_side.done(case) for case in cases)
    for case in cases[:2]:
        together, single = side_by_side.run(case), alone.run(case)
        assert together.pop("spent").keys() == single.pop("spent").keys()
        assert dump(together) == dump(single)
        assert set(alone.run(case)["pictures"]) == {"shown", "truth"}
    prepare(side_by_side, cases, 2, told.append)
    assert len(told) == 3, "nothing left to do"


class Strict:
    """Gives what was run ahead, and nothing else."""

    results = ResultCache()

    def __init__(self, prepared: set[StreamCase], finished: set[StreamCase] | None = None) -> None:
        self._prepared, self._finished = prepared, prepared if finished is None else finished

    def done(self, case: StreamCase) -> bool:
        return case in self._finished

    def cpu_s(self, case: StreamCase) -> float:
        return 1800.0

    def run(self, case: StreamCase) -> dict:
        assert case in self._prepared and case in self._finished
        summary = dict.fromkeys(("psnr_restored_db", "psnr_distorted_db", "ssim_restored", "goodput_mbps"), 1.0)
        frame = {"frame": 0, "psnr_restored_db": 1.0}
        more = {"top_lod": 2, "lod_mean": 1.0, "frames": 1, "frames_missed": 0}
        spent = {"server_ms": 3.0 if case.method == "cags" else 1.0, "client_ms": 2.0}
        more |= {"bytes_tiles": 2000, "bytes_reference": 500}
        return {"summary": summary | more, "frames": [frame], "pictures": {}, "spent": spent}


def strict(name: str, plan: Plan, left_out: tuple[str, ...] = ()) -> Context:
    cases = set(EXPERIMENTS[name].cases(Context(plan, Strict(set()), print)))
    return Context(plan, Strict(cases, {case for case in cases if case.method not in left_out}), print)


def test_streamed_experiments_ask_only_for_what_was_run_ahead():
    plan = replace(PLAN, scenes=("procedural:size=500,frames=2",))
    for name in ("fixed", "fluctuating", "range", "rivals", "sessions", "ablations", "generality"):
        assert EXPERIMENTS[name].run(strict(name, plan)).rows


def test_what_takes_longest_comes_first():
    case = StreamCase("procedural:size=500,frames=2", "cags", "synthetic:still", 2, 64, 48, "generated:steady-5")
    cases = [replace(case, method=method) for method in ("cags", "lts-f", "cags-paper", "v3-a")]
    assert [one.method for one in sorted(cases, key=_quick)] == ["cags-paper", "cags", "lts-f", "v3-a"]
    single = replace(case.encoding, settings=replace(case.encoding.settings, frames=1))
    encodings = [single, *(one.encoding for one in cases)]
    codecs = [(one.settings.codec, one.settings.frames) for one in sorted(encodings, key=_short)]
    assert codecs == [("video", 2), ("density", 2), ("svq", 2), ("svq", 2), ("svq", 1)]


def test_methods_and_links_are_chosen_and_ours_is_always_there():
    plan = replace(PLAN, chosen=("lts-f",), over=(30.0, None))
    assert (plan.methods, plan.rates_mbps, plan.links) == (("cags", "lts-f"), (30.0,), (30.0, None))
    context = strict("rivals", plan)
    assert {(c.method, c.mbps) for c in EXPERIMENTS["rivals"].cases(context)} == {
        (method, mbps) for method in ("cags", "lts-f") for mbps in (30.0, None)
    }
    rows = EXPERIMENTS["rivals"].run(context).rows
    assert [(row[1], row[3]) for row in rows] == [("30 Mbps", "LTS-F"), ("fluctuating", "LTS-F")]


def test_a_part_of_a_run_is_shown_as_far_as_it_goes():
    plan = replace(PLAN, chosen=("lts-f", "v3-a"), over=(30.0,), kept=True)
    section = EXPERIMENTS["rivals"].run(strict("rivals", plan, left_out=("v3-a",)))
    assert [row[3] for row in section.rows] == ["LTS-F"]
    assert "2 of 3 sessions of 8 frames at 64x48 were played; they took 1.00 processor hours" in section.notes[1]
    assert EXPERIMENTS["rivals"].run(strict("rivals", plan, left_out=plan.methods)).rows == []
    alone = EXPERIMENTS["sessions"].run(strict("sessions", plan, left_out=("v3-a", "lts-f")))
    assert [(row[2], row[4], row[-1]) for row in alone.rows] == [("CAGS (ours)", "64x48", 1800.0)]
    assert "1 of 3 sessions" in alone.notes[0]


def test_a_part_stands_with_its_sign_and_interval_by_scene_and_over_all():
    section = EXPERIMENTS["ablations"].run(strict("ablations", replace(PLAN, scenes=("a", "b"))))
    at = {(row[0], row[2], row[3]): row[4:] for row in section.rows}
    assert {scene for _, _, scene in at} == {"a", "b", "all scenes"}
    assert {link for _, link, _ in at} == {"30 Mbps", "60 Mbps"}
    assert all(mean == 0.0 for mean, *_ in at.values()), "two equal methods"
    assert at["motion apart from looks", "30 Mbps", "a"][-3:] == [2.0, 0.0, 0.0], "with it less without it"
    assert at["PRPA", "60 Mbps", "all scenes"][-3:] == [0.0, 0.0, 0.0]
    held = [one["name"] for one in section.checks if one["ok"]]
    assert held == ["only the effects needed: the picture stays"], "nothing is brought by a part that changes nothing"
    assert {one["name"].partition(":")[0] for one in section.checks} == {part for part, _, _ in at}


def test_what_is_not_needed_may_move_a_picture_neither_way_and_has_to_cost_time():
    class Played(Strict):
        """Leaving out effects moves the picture by ``gain``, and the client's time by ``saved``."""

        gain, saved = 0.0, 1.0

        def run(self, case: StreamCase) -> dict:
            found = super().run(case)
            if case.method == "cags":
                found["frames"] = [{**frame, "psnr_restored_db": 1.0 + self.gain} for frame in found["frames"] * 27]
                found["spent"] = {"server_ms": 1.0, "client_ms": 2.0 - self.saved}
            else:
                found["frames"] = found["frames"] * 27
            return found

    plan = replace(PLAN, scenes=("a", "b"))
    cases = set(EXPERIMENTS["ablations"].cases(Context(plan, Strict(set()), print)))

    def checks(gain: float, saved: float) -> list[bool]:
        played = Played(cases)
        played.gain, played.saved = gain, saved
        found = EXPERIMENTS["ablations"].run(Context(plan, played, print)).checks
        return [one["ok"] for one in found if one["name"].startswith("only the effects needed")]

    assert checks(0.01, 1.0) == [True, True]
    assert checks(0.2, 1.0) == [False, True], "better is not equal"
    assert checks(-0.2, 1.0) == [False, True]
    assert checks(0.0, -1.0) == [True, False]


def test_a_method_that_shows_what_another_shows_is_told():
    plan = replace(PLAN, scenes=("procedural:size=500,frames=2",))
    found = EXPERIMENTS["generality"].run(strict("generality", plan)).checks[0]
    assert (found["value"], found["ok"]) == (16, False), "four kinds of motion, five methods that show one thing"


def test_films_are_measured_only_where_a_table_shows_them():
    plan = replace(PLAN, video=("vmaf",), lpips="w.npz")
    context = Context(plan, Strict(set()), print)
    shown = context.case("a", "cags", 30.0)
    assert (shown.video, shown.lpips) == (("vmaf",), "w.npz")
    fast = context.case("a", "cags", 150.0)
    assert (fast.video, fast.lpips) == ((), "w.npz"), "a quick run films the slowest link and the trace"
    assert context.case("a", "cags").video == ("vmaf",)
    assert Context(replace(plan, quick=False), Strict(set()), print).case("a", "cags", 150.0).video == ("vmaf",)
    for other in (
        context.case("a", "pictures", 30.0),
        context.case("b", "cags", 30.0),
        context.case("a", "cags", unscaled=True),
    ):
        assert (other.video, other.lpips) == ((), "")


def test_components_are_timed_on_one_view(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    plan = replace(PLAN, scenes=("procedural:size=500,frames=2",), frames=2)
    section = EXPERIMENTS["components"].run(Context(plan, Runner(ResultCache(tmp_path / "r")), lambda _: None))
    times = {row[0]: row[1] for row in section.rows}
    assert {"correct by a new difference", "correct by a new picture", "PRPA", "colour restoration"} <= set(times)
    assert all(ms > 0 for ms in times.values())


@pytest.fixture(scope="module")
def still(tmp_path_factory):
    """Sections of still measurements of a small room."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        plan = replace(
            PLAN, scenes=("procedural:size=2000,frames=2",), frames=2, poses="synthetic:walking", width=320, height=240
        )
        context = Context(plan, Runner(ResultCache(tmp_path_factory.mktemp("r")), progress=False), lambda _: None)
        yield {name: EXPERIMENTS[name].run(context) for name in ("motivation", "svq", "ladder", "layers")}


def test_a_picture_puts_the_colours_of_a_coarse_quantiser_right(still):
    section = still["motivation"]
    rows = [dict(zip(section.columns, row, strict=True)) for row in section.rows]
    assert [row["config"] for row in rows] == [1, 2, 3, 4, 5]
    sizes = [row["bytes a splat"] for row in rows]
    assert sizes == sorted(sizes)
    assert rows[0]["by example (ours) [dB]"] > rows[0]["distorted [dB]"] + 3
    assert rows[-1]["distorted [dB]"] > rows[0]["distorted [dB]"] + 3, "more bits lose less"
    assert len({row["reference upsampled [dB]"] for row in rows}) == 1, "it sees no quantiser"
    claims = {one["name"]: one for one in section.checks}
    assert claims["by example (ours) above distorted, every flat quantiser"]["ok"] is (
        "sure at 5 of 5" in claims["by example (ours) above distorted, every flat quantiser"]["value"]
    )


def test_other_formats_stand_beside_svq_and_published_rows_say_so(still):
    section = still["svq"]
    rows = [dict(zip(section.columns, row, strict=True)) for row in section.rows]
    here = {row["method"]: row for row in rows if row["source"] == "measured here"}
    assert set(here) == {"SVQ paper-66", "SVQ paper-76", "SVQ layered", "SPZ", "SOG"}
    assert all(row["decoding [ms]"] > 0 and row["PSNR [dB]"] > 20 for row in here.values())
    published = [row for row in rows if row["source"] != "measured here"]
    assert {row["method"] for row in published} > {"SPZ low", "CompGS", "HAC", "HAC++", "GIFStream", "QUEEN"}
    assert all("CAGS paper" in row["source"] and row["on"] in DATASETS for row in published)
    found = {one["name"]: one["ok"] for one in section.checks}
    assert len(found) == 6
    assert not found["SVQ 66 bit is smaller than SPZ"], "one scene makes no interval"


def test_a_longer_ladder_looks_better(still):
    for name in ("ladder", "layers"):
        quality = {}
        for row in still[name].rows:
            quality.setdefault(row[0], []).append(row[3])
        assert all(found[-1] >= found[0] for found in quality.values())
        assert any(found[-1] > found[0] + 1 for found in quality.values())


@pytest.mark.parametrize(("factor", "ok"), [(0.5, True), (0.99, False), (1.5, False)])
def test_a_format_is_beaten_only_for_sure(factor, ok):
    other = {"psnr_db": [40.0, 41.0], "bytes": 100.0, "decoding_ms": 10.0}
    scenes = [
        {
            "paper-66": {
                "psnr_db": [p - (factor - 1) for p in other["psnr_db"]],
                "bytes": 100 * f,
                "decoding_ms": 10 * f,
            },
            "SPZ": other,
        }
        for f in (factor - 0.02, factor, factor + 0.02)
    ]
    found = [one["ok"] for one in _against("SPZ", scenes)]
    assert found == [factor < 1, ok, ok]


def test_the_same_session_gives_the_same_bytes_with_any_threads(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    plan = replace(PLAN, scenes=("procedural:size=500,frames=3",), frames=3)
    section = EXPERIMENTS["determinism"].run(Context(plan, Runner(ResultCache(tmp_path / "r")), lambda _: None))
    assert [row[1] for row in section.rows] == [1, 2, 2]
    assert len({row[2] for row in section.rows}) == 1
    assert section.checks[0]["ok"]
    assert not (tmp_path / "r").exists(), "computed, and not found"
