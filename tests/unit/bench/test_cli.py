"""Every subcommand that is advertised exists and explains itself."""

import errno
import importlib
import io
import json
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from cags_bench.cli import SUBCOMMANDS, main
from cags_bench.demo import cli as demo
from cags_bench.demo import run
from cags_bench.demo.run import check_replaceable
from cags_bench.demo.settings import DemoSettings
from cags_bench.tables import print_lines
from cags_common.errors import CagsError, ConfigError, OutputError
from cags_shaper.trace import open_trace


@pytest.mark.parametrize("name", SUBCOMMANDS)
def test_subcommands_explain_themselves(name, capsys):
    with pytest.raises(SystemExit) as done:
        main([name, "--help"])
    assert done.value.code == 0
    shown = capsys.readouterr().out
    assert f"cags-bench {name}" in shown
    assert "--json" in shown
    assert importlib.import_module(f"cags_bench.{name}.command").EXAMPLES.strip().splitlines()[0].strip() in shown


@pytest.mark.parametrize("name", SUBCOMMANDS)
def test_every_line_names_its_benchmark_and_where_it_was_measured(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Lines of cases of codec, network and scale did not, although the documentation says so."""
    module = importlib.import_module(f"cags_bench.{name}.command")
    monkeypatch.setattr(module, "run", lambda arguments: iter([{"case": "one"}, {"summary": True, "checks": []}]))
    given = ["--poses", "walks"] if name == "predict" else []
    assert main([name, "--json", *given]) == 0
    lines = [json.loads(text) for text in capsys.readouterr().out.splitlines()]
    assert [line.get("case") for line in lines] == ["one", None]
    assert all(line["benchmark"] == name and line["machine"] and line["commit"] for line in lines)


def test_lists_in_tables_are_rounded_as_numbers_are(capsys: pytest.CaptureFixture[str]) -> None:
    print_lines([{"case": "one", "level": [1.482854999949268, None, 15947.06099990617]}], sys.stdout)
    assert capsys.readouterr().out == "case=one  level=[1.483, None, 15,947]\n"


def test_without_a_subcommand_the_list_is_shown(capsys):
    assert main([]) == 2
    shown = capsys.readouterr().out
    assert all(name in shown for name in SUBCOMMANDS)


def test_the_demo_replaces_only_its_own_reports(tmp_path):
    check_replaceable(tmp_path / "new")
    check_replaceable(tmp_path)
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(CagsError, match="not an earlier report"):
        check_replaceable(tmp_path)
    (tmp_path / "summary.json").write_text("{}")
    check_replaceable(tmp_path)


@pytest.fixture
def played(monkeypatch: pytest.MonkeyPatch) -> DemoSettings:
    """A demo whose play takes no time, and whose report has one file beside the summary."""

    def stream(bundle: str, settings: DemoSettings, report: Path, progress: object, **limits: float | None) -> int:
        (report / "frames.jsonl").write_text("new")
        return 0

    def write(report: Path, settings: DemoSettings, frames: int) -> dict[str, int]:
        (report / "summary.json").write_text("new")
        return {}

    monkeypatch.setattr(run, "demo_bundle", lambda *rest: Path("clip.cags"))
    monkeypatch.setattr(run, "clip_length", lambda bundle: (90, 30.0))
    monkeypatch.setattr(run, "stream_once", stream)
    monkeypatch.setattr(run, "write_report", write)
    return DemoSettings()


def earlier_report(folder: Path) -> Path:
    (folder / "stages").mkdir(parents=True)
    for name in ("summary.json", "strip.png", "stages/frame.png"):
        (folder / name).write_text("old")
    return folder


def contents(folder: Path) -> dict[str, str]:
    return {str(path.relative_to(folder)): path.read_text() for path in folder.rglob("*") if path.is_file()}


NEW = {"summary.json": "new", "frames.jsonl": "new"}


def play(settings: DemoSettings, out: object) -> None:
    run.run_demo("procedural", replace(settings, out=str(out)), io.StringIO())


def test_the_demo_makes_its_folder_and_replaces_an_earlier_report(played, tmp_path):
    play(played, tmp_path / "deep" / "report")
    assert contents(tmp_path / "deep" / "report") == NEW
    report = earlier_report(tmp_path / "report")
    play(played, report)
    assert contents(report) == NEW
    assert not (report / "stages").exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["deep", "report"]


def test_the_demo_replaces_the_report_that_it_is_run_in(played, tmp_path, monkeypatch):
    """``--out .`` once deleted the old report, and lost the new one with it."""
    monkeypatch.chdir(earlier_report(tmp_path / "report"))
    play(played, ".")
    assert contents(tmp_path / "report") == contents(Path()) == NEW


@pytest.mark.parametrize(
    ("strip", "words"),
    [
        ({"frame": 15, "gain_db": 2.34}, ": effect of references on frame 15, the saved one that gains most (2.3 dB)"),
        ({"frame": 0, "gain_db": 0.0}, ": frame 0 beside the truth; nothing had to be corrected in the saved frames"),
        ({"frame": 0, "gain_db": -0.1}, ": frame 0 beside the truth; references improved none of the saved frames"),
        (None, "none: no frame whose pictures are saved was shown"),
    ],
)
def test_the_demo_says_what_its_strip_shows(strip, words):
    assert demo._pictures(strip, Path("strip.png")) == ("" if strip is None else "strip.png") + words


@pytest.mark.parametrize(
    ("gains_db", "chosen"),
    [([0.0, 3.0, 1.0], {"frame": 15, "gain_db": 3.0}), ([0.0, 0.0], {"frame": 0, "gain_db": 0.0}), ([], None)],
)
def test_the_demo_reports_the_frame_of_its_strip(tmp_path, gains_db, chosen):
    frames = [  # those of every 15th frame are saved
        {"frame": frame, "time_us": frame, "psnr_distorted_db": 30.0, "psnr_restored_db": 30.0 + gain_db}
        | {"lod_mean": 1.0, "bytes_tiles": 1, "bytes_reference": 1, "half": False}
        for frame, gain_db in [*zip((0, 15, 30), gains_db, strict=False), (31, 5.0)]
    ]
    lines = [*frames, {"summary": True}]
    (tmp_path / "frames.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    (tmp_path / "stages").mkdir()
    for frame in frames:
        picture = np.zeros((60, 80, 3), np.uint8)
        cv2.imwrite(str(tmp_path / "stages" / f"frame_{frame['frame']:04d}_restored.png"), picture)
    assert run.write_report(tmp_path, DemoSettings(), 30)["strip"] == chosen
    assert (tmp_path / "strip.png").exists() == (chosen is not None)


def test_the_demo_plots_the_link_from_the_connection_on(tmp_path, monkeypatch):
    frame = {"frame": 0, "time_us": 9_000_000, "psnr_distorted_db": 30.0, "psnr_restored_db": 30.0}
    frame |= {"lod_mean": 1.0, "bytes_tiles": 1, "bytes_reference": 1, "half": False}
    lines = [frame, {"summary": True, "first_frame_ms": 2500.0}]
    (tmp_path / "frames.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    (tmp_path / "stages").mkdir()
    plotted = []
    monkeypatch.setattr(run, "plot_stream", lambda frames, path, **beside: plotted.append(beside))
    settings = DemoSettings()
    run.write_report(tmp_path, settings, 30)
    [beside] = plotted
    assert beside["waited_s"] == 2.5
    assert beside["link"].mean_bps(0, 100_000) == open_trace(run.link_trace(settings)).mean_bps(0, 100_000)


def test_a_link_to_a_report_stays_a_link(played, tmp_path):
    report, link = earlier_report(tmp_path / "report"), tmp_path / "link"
    for target in (report, tmp_path / "yet to come"):
        link.unlink(missing_ok=True)
        link.symlink_to(target)
        play(played, link)
        assert link.is_symlink()
        assert contents(target) == NEW


def test_a_report_that_cannot_be_replaced_stays(tmp_path, monkeypatch):
    report, made = earlier_report(tmp_path / "report"), tmp_path / "scratch" / "report"
    before = contents(report)
    made.mkdir(parents=True)
    (made / "summary.json").write_text("new")
    rename = Path.rename

    def fail(path: Path, target: Path) -> Path:
        if path.parent == made:
            raise OSError(errno.EIO, "broken disk")
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", fail)
    with pytest.raises(OutputError, match=r"report: cannot be written \(broken disk\)"):
        run.replace_report(made, report)
    assert contents(report) == before


@pytest.mark.parametrize("flag", ["--out", "--cache"])
def test_the_demo_tells_which_folder_cannot_be_written_before_it_encodes(tmp_path, monkeypatch, capsys, flag):
    monkeypatch.setattr("cags_encoder.encode", lambda *rest: pytest.fail("a scene was encoded"))
    taken = tmp_path / "taken"
    taken.write_text("a file")
    folder = taken / "report" if flag == "--out" else taken
    assert demo.main(["procedural:size=500", "--out", str(tmp_path / "out"), flag, str(folder)]) == 1
    said = capsys.readouterr().err.splitlines()[-1]
    assert f"cags-demo: {taken}: cannot be written" in said
    assert said.endswith("choose another place")


@pytest.mark.parametrize(
    ("scene", "asked", "frames"),
    [("frames=10", 0, 10), ("frames=120", 0, 90), ("frames=1", 0, 90), ("frames=10", 25, 25), ("frames=10", 5, 5)],
)
def test_the_demo_plays_a_scene_once_unless_more_is_asked_for(monkeypatch, scene, asked, frames):
    """A scene of 10 frames once went round nine times, though --help said otherwise."""
    monkeypatch.setattr(run, "cached_bundle", lambda spec, cache, settings: settings.frames)
    assert run.demo_bundle(f"procedural:size=500,{scene}", run.NATIVE, DemoSettings(frames=asked)) == frames


def test_the_demo_plays_the_first_frames_of_a_bundle(
    played: DemoSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "manifest.json").write_text("{}")
    asked: list[float | None] = []

    def stream(bundle: str, settings: DemoSettings, report: Path, progress: object, **limits: float | None) -> int:
        asked.append(limits["duration_s"])
        return 0

    monkeypatch.setattr(run, "stream_once", stream)
    for frames in (0, 45, 90):
        run.run_demo(str(tmp_path), replace(played, out=str(tmp_path / "out"), frames=frames), io.StringIO())
    assert asked == [None, 1.5, None]
    with pytest.raises(ConfigError, match="has 90; give fewer"):
        run.run_demo(str(tmp_path), replace(played, out=str(tmp_path / "out"), frames=91), io.StringIO())
    with pytest.raises(ConfigError, match=r"--view plays all of the bundle .*; leave it out"):
        run.show_live(str(tmp_path), replace(played, frames=45), io.StringIO())


def test_the_demo_takes_a_bundle_as_it_is_but_no_published_folder(tmp_path: Path) -> None:
    """It said that the bundle holds no frames."""
    (tmp_path / "manifest.json").write_text("{}")
    assert run.demo_bundle(str(tmp_path), run.NATIVE, DemoSettings()) == tmp_path
    (tmp_path / "manifest.json").write_text('{"published": {"codebooks": "codebooks.bin"}}')
    with pytest.raises(ConfigError, match="is published, without the source frames"):
        run.demo_bundle(str(tmp_path), run.NATIVE, DemoSettings())


@pytest.mark.parametrize(
    ("flag", "words"), [("--trace", "no.such.trace: cannot be read"), ("--poses", "no.such.trace")]
)
@pytest.mark.parametrize("view", [[], ["--view"]])
def test_the_demo_tells_what_cannot_be_read_before_it_encodes(tmp_path, monkeypatch, capsys, flag, words, view):
    monkeypatch.setattr("cags_bench.demo.run.cached_bundle", lambda *rest: pytest.fail("a scene was encoded"))
    given = ["procedural:size=500", flag, "no.such.trace", "--out", str(tmp_path / "out"), *view]
    assert demo.main(given) == 1
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
