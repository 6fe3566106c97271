"""What somebody adds joins the reproduction: a policy, a predictor or a restorer is a method beside ours."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from cags_bench.film import ffmpeg
from cags_bench.reproduce import added, run
from cags_bench.reproduce.cache import ResultCache
from cags_bench.reproduce.cases import Runner, StreamCase
from cags_bench.reproduce.experiments.streaming import fixed
from cags_bench.reproduce.methods import METHODS
from cags_bench.reproduce.plan import Context, Plan
from cags_bench.reproduce.settings import ReproduceSettings
from cags_server.predict import PREDICTORS
from cags_server.ratecontrol import RATE_POLICIES

SCENE = "procedural:size=500,frames=6"
SMALL = (SCENE,), "synthetic:walking", "generated:steady-5", 6, 64, 48
THRIFTY = '''
from cags_server.fov.fixed import FixedFov
from cags_server.predict.hold import HoldPredictor
from cags_server.ratecontrol.base import Decision


class Still(HoldPredictor):
    """Says that nobody moves."""


def wide(options):
    return FixedFov(options.margin + 0.4)


class Thrifty:
    """Sends nothing but what the server sends by itself."""

    def decide(self, observation):
        return Decision((), 0)
'''


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A package that is installed beside the program, and registers policies and a predictor by entry points."""
    (tmp_path / "thrifty_policy.py").write_text(THRIFTY)
    info = tmp_path / "thrifty_policy-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: thrifty-policy\nVersion: 1.0\n")
    entries = {"rate_policies": "thrifty = thrifty_policy:Thrifty", "predictors": "still = thrifty_policy:Still"}
    entries["fov_policies"] = "wide = thrifty_policy:wide"
    lines = (f"[cags.{group}]\n{entry}\n" for group, entry in entries.items())
    (info / "entry_points.txt").write_text("".join(lines))
    # syspath_prepend fails where kosoku's pkg_resources was loaded
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    importlib.invalidate_caches()
    yield tmp_path
    sys.modules.pop("thrifty_policy", None)


class Stubborn:
    """A predictor that is entered in the registry."""

    def __init__(self) -> None:
        self._still = PREDICTORS["hold"]()

    def predict(self, history, horizon_us):
        return self._still.predict(history, horizon_us)


def test_nothing_is_added_by_the_program_itself() -> None:
    assert added.names() == ()
    assert set(RATE_POLICIES.names()) > {"utility", "paper"}, "which are its own, by entry points too"


def test_what_is_installed_or_entered_is_a_method(installed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(PREDICTORS, "stubborn", Stubborn)
    assert added.names() == ("abr=thrifty", "fov=wide", "predictor=stubborn", "predictor=still")
    assert METHODS["abr=thrifty"].server == {"abr": "thrifty"}
    assert METHODS["fov=wide"].server == {"fov": "wide"}
    assert METHODS["predictor=stubborn"].server == {"predictor": "stubborn"}
    assert set(added.names()) < set(Plan(*SMALL, quick=True).methods)


@pytest.mark.parametrize("name", ["abr=utility", "abr=paper", "abr=nothing", "fov=fixed", "cags2"])
def test_what_was_not_added_is_no_method(name: str) -> None:
    with pytest.raises(KeyError):
        METHODS[name]


def test_a_change_of_the_policy_is_another_case(installed: Path) -> None:
    case = StreamCase(SCENE, "abr=thrifty", "synthetic:walking", 6, 64, 48, "generated:steady-5")
    before = case.key("auto")
    (installed / "thrifty_policy.py").write_text(THRIFTY + "\n")
    assert case.key("auto") != before
    assert added.digest("cags") == ""


def test_the_policy_is_played_and_has_a_row_of_the_table(installed: Path, tmp_path: Path) -> None:
    plan = Plan(*SMALL, quick=True)
    runner = Runner(ResultCache(tmp_path / "results"), str(tmp_path / "bundles"), threads=1, progress=False)
    context = Context(plan, runner, lambda _: None)
    ours, theirs = (context.result(context.case(SCENE, method, 30.0)) for method in ("cags", "abr=thrifty"))
    assert theirs["summary"]["frames"] == 6
    assert theirs["summary"]["bytes_tiles"] < ours["summary"]["bytes_tiles"]

    class Fast(Context):
        """Every other method stands for ours."""

        def result(self, case: StreamCase) -> dict:
            return theirs if case.method == "abr=thrifty" else ours

    margins = [
        context.result(context.case(SCENE, method, 30.0))["frames"] for method in ("fov=wide", "predictor=still")
    ]
    assert all(len(frames) == 6 for frames in margins)

    rows = {row[0]: row for row in fixed(Fast(plan, runner, lambda _: None)).rows}
    assert rows["CAGS, abr thrifty"][2] == pytest.approx(theirs["summary"]["psnr_restored_db"])


@pytest.mark.slow
@pytest.mark.skipif(ffmpeg.program() is None, reason="the extra video-metrics is not installed")
def test_films_of_its_plays_are_measured_where_that_is_asked_for(tmp_path: Path) -> None:
    runner = Runner(ResultCache(tmp_path / "results"), str(tmp_path / "bundles"), threads=1, progress=False)
    case = StreamCase(SCENE, "cags", "synthetic:still", 6, 64, 48, "", mbps=1000.0, video=("vmaf", "xpsnr"))
    found, plain = runner.compute(case), runner.compute(replace(case, video=()))
    assert found["summary"]["vmaf"] > 80
    assert found["summary"]["xpsnr_db"] > 30
    assert {"vmaf", "xpsnr_db"} == set(found["summary"]) - set(plain["summary"])
    assert found["summary"]["psnr_restored_db"] == plain["summary"]["psnr_restored_db"]
    assert case.key("auto") != replace(case, video=()).key("auto")


def test_metrics_that_cannot_be_had_are_told_once_and_left_out(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(run, "lacking", lambda metrics: {"vmaf": "pip install it"})
    assert run._plan(ReproduceSettings(quick=True)).video == ("xpsnr",)
    assert capsys.readouterr().err == "reproduce: vmaf is not measured: pip install it\n"
