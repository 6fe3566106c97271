"""What experiments cannot read or write is told in one line, before anything is measured."""

from __future__ import annotations

from pathlib import Path

import pytest

from cags_bench.cli import main
from cags_bench.outputs import check_output_file
from cags_common.errors import ConfigError

WORK = (
    "scale.command._servers",
    "scale.sizing.viewer_lines",
    "cost.sweep.graphics",
    "cost.sweep.capture",
    "reproduce.run.prepare",
    "web.experiment.programs",
    "web.experiment.cached_bundle",
    "motion.experiment._rates",
    "motion.experiment.evaluation_times",
    "motion.experiment.write_film",
    "references.cases.cached_bundle",
    "references.experiment.in_parallel",
    "codec.experiment.ladder",
    "codec.experiment.scaling",
    "network.command._cases",
    "raster.cases.view_of",
    "raster.backends.view_of",
)
"""Where the work of the commands begins."""

ROOM = "procedural:size=500,frames=2"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with a file ``taken``; measuring anything fails."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "taken").write_text("a file")

    def measured(*_: object, **__: object) -> None:
        pytest.fail("it was measured")

    for name in WORK:
        monkeypatch.setattr(f"cags_bench.{name}", measured)
    return tmp_path


def refusal(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    code = main(list(arguments))
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1, said.err
    return code, said.err.removeprefix("cags-bench: ").rstrip("\n")


NO_FOLDER = "there is no folder nodir; name a file in an existing one"
NO_PLACE = "taken: cannot be written (it is no folder); choose another place"


@pytest.mark.parametrize(
    ("command", "code", "words"),
    [
        ("scale --job-ms 18 --plot nodir/x.png", 2, f"plot = 'nodir/x.png': {NO_FOLDER}"),
        ("scale --job-ms 18 --plot x.foo", 2, "plot = 'x.foo' must end in .png, .svg or .pdf"),
        ("scale --table nodir/x.md", 2, f"table = 'nodir/x.md': {NO_FOLDER}"),
        ("scale --table .", 2, "table = '.': . is a folder; name a file in an existing one"),
        ("scale --table x.md --job-ms 18", 2, "with job_ms = 18 none is; leave out --table or --job-ms"),
        ("cost --budget-ms 33 --config-out nodir/x.toml", 2, f"config_out = 'nodir/x.toml': {NO_FOLDER}"),
        (f"cost --scenes {ROOM} --out taken", 1, NO_PLACE),
        (f"reproduce --table components --scenes {ROOM} --out taken", 1, NO_PLACE),
        ("web --pictures taken", 1, NO_PLACE),
        ("motion --film x.txt", 2, "film = 'x.txt' must end in .png"),
        ("motion --film taken/x.png", 1, NO_PLACE),
    ],
)  # fmt: skip
def test_outputs_that_cannot_be_written_are_refused_first(
    capsys: pytest.CaptureFixture[str], command: str, code: int, words: str
) -> None:
    found, said = refusal(capsys, *command.split())
    assert (found, words in said) == (code, True), said


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("references --scenes ROOM --before nosuch", "before = 'nosuch' is not a program"),
        ("references --scenes ROOM --poses nosuch", "nosuch"),
        ("references --scenes ROOM;nosuch", "nosuch"),
        ("codec ROOM --clip nosuch", "nosuch"),
        ("codec ROOM nosuch", "nosuch"),
        ("motion --scenes ROOM --film x.png --film-scene nosuch", "nosuch"),
        ("motion --scenes ROOM --film x.png --film-trace nosuch", "nosuch"),
        ("motion --film-scene nosuch", "film_scene = 'nosuch' is for a film strip; add --film FILE.png or"),
        ("network --parts sending,content --traces generated:steady-30,nosuch", "nosuch"),
        ("network --parts sending,content --policies utility,greedy", "abr = 'greedy' is unknown"),
        ("network --parts sending,content --poses nosuch", "nosuch"),
        ("network --parts sending,first --first-scene nosuch", "nosuch"),
        ("reproduce --table components --scenes ROOM --poses nosuch", "nosuch"),
        ("reproduce --table components --scenes ROOM --trace nosuch", "nosuch"),
        ("cost --scenes ROOM --trace nosuch", "nosuch"),
        ("cost --scenes ROOM --poses nosuch", "nosuch"),
    ],
)  # fmt: skip
def test_inputs_that_cannot_be_read_are_refused_first(
    capsys: pytest.CaptureFixture[str], command: str, words: str
) -> None:
    found, said = refusal(capsys, *command.replace("ROOM", ROOM).split())
    assert found in (1, 2)
    assert words in said, said


@pytest.mark.parametrize("backends", [[], ["--backends", "cpu"]])
@pytest.mark.parametrize("sizes", ["0x0", "400x0", "-3x40", "400x300,9x300", "8193x10"])
def test_images_of_no_size_are_refused(capsys: pytest.CaptureFixture[str], sizes: str, backends: list[str]) -> None:
    found, said = refusal(capsys, "raster", f"--sizes={sizes}", "--scenes", ROOM, *backends)
    assert (found, said) == (2, f"sizes = {sizes!r}: sides must lie in 10 to 8192 pixels")


def test_files_may_be_replaced_and_links_and_devices_written(folder: Path) -> None:
    (folder / "link").symlink_to(folder / "yet to come")
    for name in ("taken", "new", "link", "/dev/null"):
        check_output_file("table", name)
    assert sorted(path.name for path in folder.iterdir()) == ["link", "taken"]
    with pytest.raises(ConfigError, match="table = 'a': there is no folder b"):
        check_output_file("table", "a", Path("b/c"))
