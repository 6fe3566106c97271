"""``cags-encode`` says in one line what is wrong, of what, and what would do; and it destroys nothing by it."""

import os
import shutil
from pathlib import Path

import pytest

from cags_encoder import EncodeSettings, encode
from cags_encoder.cli import main
from support.codec_scenes import cloud


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("bundles") / "a.cags"
    encode([cloud(300)], EncodeSettings(train_splats=500, lod_order="paper"), str(out))
    return out


@pytest.fixture
def bundle(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "a.cags"))


def refused(capsys: pytest.CaptureFixture[str], code: int, *arguments: str) -> str:
    capsys.readouterr()
    assert main(list(arguments)) == code
    (line,) = capsys.readouterr().err.splitlines()
    return line


WRONG = [
    ("--codec", "bogus"),
    ("--lod-order", "no-such-file"),
    ("--view", "no-such-file"),
    ("--codec", "bogus", "--no-resume"),
    ("--lod-order", "no-such-file", "--no-resume"),
    ("--view", "no-such-file", "--no-resume"),
]


@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("scheme", ["", "local://", "file://"])
def test_a_wrong_setting_destroys_nothing(
    bundle: Path, tmp_path: Path, scheme: str, wrong: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "precious.txt").write_text("x")
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    for out in ("a.cags", "data", "new"):
        assert wrong[1] in refused(capsys, 2, "procedural:size=500,frames=1", f"{scheme}{tmp_path}/{out}", *wrong)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before


def test_a_quantiser_for_a_codec_that_has_none_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    """It changed nothing, and --inspect named it beside the codec."""
    said = refused(capsys, 2, "procedural:size=500", "a.cags", "--codec", "density", "--quantiser", "paper-66")
    assert said == (
        "cags-encode: quantiser = 'paper-66' is of the codec svq, and codec = 'density': leave one of them out"
    )


@pytest.mark.parametrize("given", ["", "manifest.json"])
def test_a_bundle_as_a_scene_is_told_with_what_takes_it(
    given: str, bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = refused(capsys, 2, str(bundle / given), str(tmp_path / "b.cags"))
    assert said == (
        f"cags-encode: {bundle / given}: is a bundle, which is encoded already; cags-server --bundle "
        f"{bundle} plays it, and cags-encode --inspect describes it"
    )


def test_a_scene_on_another_machine_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = refused(capsys, 2, "s3://bucket/clip.ply", str(tmp_path / "b.cags"))
    assert said.startswith("cags-encode: SCENE s3://bucket/clip.ply: is not on this machine; copy it here")


def test_damaged_bundles_are_named(bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    codebooks = bundle / "codebooks.bin"
    codebooks.write_bytes(codebooks.read_bytes()[:-9])
    view = tmp_path / "view.json"
    view.write_text("{}")
    for _ in range(2):
        for command in (
            ["--inspect", str(bundle)],
            ["--verify", str(bundle)],
            ["--export", str(bundle), "0", str(tmp_path / "x.ply")],
            ["--set-view", str(bundle), str(view)],
        ):
            assert refused(capsys, 1, *command).startswith(f"cags-encode: {bundle}: ")
        (bundle / "manifest.json").write_text("{")


def test_a_level_that_is_not_there_is_named_with_its_bundle(
    bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = refused(capsys, 1, "--export", str(bundle), "0:99", str(tmp_path / "x.ply"))
    assert said.startswith(f"cags-encode: {bundle}: LoD 99 is outside 0 to ")


@pytest.mark.parametrize("more", [[], ["--no-resume"]])
def test_an_output_that_cannot_be_written_is_named(
    tmp_path: Path, more: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = "procedural:size=500,frames=1"
    (tmp_path / "file").write_text("x")
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path / "empty")
    for out, why in (
        (str(tmp_path / "file" / "out"), "is not a folder"),
        (str(tmp_path / ("n" * 300)), "choose a shorter name"),
        ("/proc/x", "cannot be written (No such file or directory)"),
        (".", "would replace the current folder"),
    ):
        said = refused(capsys, 1, scene, out, *more)
        assert said.startswith(f"cags-encode: {out}: ") and why in said and "--no-resume" not in said
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["empty", "file"]


@pytest.mark.parametrize("name", ["plot", ".png", "plot.xyz"])
def test_a_plot_is_written_under_its_name_or_not_at_all(
    bundle: Path, tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    said = refused(capsys, 1, "--inspect", str(bundle), "--plot", str(tmp_path / name))
    assert f"{tmp_path / name}: is no kind of picture" in said and ".png, .svg or .pdf" in said
    assert [path.name for path in tmp_path.iterdir()] == ["a.cags"]


def test_settings_may_come_through_pipes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, into = os.pipe()
    os.write(into, b'{"title": "Through a pipe"}')
    os.close(into)
    given = ("--view", f"/dev/fd/{out}", "--lod-order", "paper", "--workers", "1", "--train-splats", "300")
    try:
        assert main(["procedural:size=500,frames=1", str(tmp_path / "out"), *given]) == 0
    finally:
        os.close(out)
    assert "Through a pipe" in (tmp_path / "out" / "manifest.json").read_text()


@pytest.mark.parametrize("place", range(3))
def test_flags_may_stand_anywhere(place: int, tmp_path: Path) -> None:
    words = ["procedural:size=500", str(tmp_path / "out")]
    words[place:place] = ["--frames", "1", "--workers", "1", "--lod-order", "paper", "--no-resume"]
    assert main(words) == 0
    assert (tmp_path / "out" / "manifest.json").exists()
