"""What people get wrong with every command: one line that names the thing, what is wrong with it, and a way out."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path

import pytest

from cags_common.runtime.entry import COMMANDS as MODULES

NOBODY = "ws://127.0.0.1:1/stream"
STEADY = "--trace=generated:steady-30"

WRONG = {
    # no or unknown arguments
    "cags-server": (2, "--bundle FOLDER_OR_URL"),
    "cags-client": (2, "--url"),
    "cags-encode": (2, "--help"),
    "cags-train": (2, "--help"),
    "cags-train magic": (2, "predictor"),
    "cags-bench magic": (2, "known: stream"),
    "cags-bench stream nowhere": (2, "--help"),
    "cags-doctor --frobnicate": (2, "--help"),
    "cags-doctor --threads -1": (2, "at least 1"),
    # values
    "cags-server --bundle x --port abc": (2, "'abc'"),
    "cags-server --bundle x --port 99999": (2, "[0, 65535]"),
    "cags-server --bundle {bundle} --predictor magic": (2, "known: hold"),
    "cags-server --bundle {bundle} --tls-cert cert.pem": (2, "tls-key"),
    "cags-client --url {nobody} --width 0": (2, "[1, 8192]"),
    "cags-client --url {nobody} --stages pictures --stages-every 0": (2, "at least 1"),
    "cags-client --url {nobody} --view --record x": (2, "--record does not go with --view, which has no end"),
    "cags-client --url {nobody} --view-port 0": (2, "add --view"),
    "cags-client --url {nobody} --shaper-control foo": (2, "add --view"),
    "cags-client --url {nobody} --record x.mkv": (2, "--record x.mkv: .mkv is no format to record"),
    "cags-client --url {nobody} --record {bundle}": (2, "the folder holds other files"),
    "cags-client --url {nobody} --stages {bundle}": (2, "the folder holds other files"),
    "cags-client --url {nobody} --json {bundle}": (2, "is a folder"),
    "cags-client --url {nobody} --config none.toml": (2, "give an existing TOML file"),
    "cags-encode procedural:size=-1 out": (2, "4000000"),
    "cags-encode procedural:frobs=1 out": (2, "known: size"),
    "cags-shaper --to nonsense {steady}": (2, "HOST:PORT"),
    "cags-shaper --to 127.0.0.1:1 {steady} --delay-ms -5": (2, "60000"),
    "cags-encode --verify {bundle} --frames 3": (2, "--frames is an option of encoding"),
    "cags-demo --frames x": (2, "'x'"),
    "cags-demo --view --json": (2, "leave --view out"),
    # files and folders
    "cags-server --bundle nowhere": (1, "no such folder"),
    "cags-server --bundle {empty}": (1, "made by cags-encode"),
    "cags-server --bundle notes.txt": (1, "is a file"),
    "cags-server --bundle {old}": (1, "encode again"),
    "cags-server --bundle {bundle} --session-logs notes.txt": (1, "choose another place"),
    "cags-server --bundle {bundle} --event-traces notes.txt": (1, "choose another place"),
    "cags-server --bundle foo://x": (1, "s3://BUCKET/NAME"),
    "cags-client --url {nobody} --truth nowhere": (1, "no such folder"),
    "cags-client --url {nobody} --json /nowhere/x.jsonl": (1, "make it first"),
    "cags-encode nowhere out": (1, "or 'procedural'"),
    "cags-encode {empty} out": (1, "supported are .ply"),
    "cags-encode notes.txt out": (1, "known: .ply"),
    "cags-encode broken.ply out": (1, "check the file's type"),
    "cags-encode procedural:size=500,frames=1 {full}": (1, "give another name"),
    "cags-encode --inspect {old}": (1, "encode again"),
    "cags-encode --verify {empty}": (1, "made by cags-encode"),
    "cags-shaper --to 127.0.0.1:1 --trace nowhere": (1, "give an existing trace file"),
    "cags-shaper --to 127.0.0.1:1 --trace generated:magic": (1, "known: "),
    "cags-shaper --to 127.0.0.1:1 --trace notes.txt": (1, "notes.txt:1"),
    "cags-demo nowhere": (1, "or 'procedural'"),
    "cags-demo --out {full}": (1, "--out"),
    # who is there, and who is not
    "cags-client --url 127.0.0.1:8765": (1, "ws://HOST:PORT/stream"),
    "cags-client --url http://127.0.0.1:8765/stream": (1, "ws://HOST:PORT/stream"),
    "cags-encode {bundle} out": (2, "cags-server --bundle"),
    "cags-encode s3://x/clip.ply out": (2, "copy it here"),
    "cags-encode procedural out --gof-frames 0": (2, "at least 1"),
    "cags-encode --set-view {bundle} nowhere": (2, "as the page"),
    "cags-server --bundle x --tls-cert nowhere --tls-key notes.txt": (2, "give a PEM file"),
    "cags-server --bundle x --tls-cert notes.txt --tls-key notes.txt": (2, "both as PEM"),
    "cags-server --config notes.txt": (2, "notes.txt: is not TOML"),
    "cags-shaper --plot nowhere": (1, "cags-shaper --log"),
    "cags-shaper --plot notes.txt": (1, "cags-shaper --log"),
    "cags-client --url {nobody}": (1, "start cags-server"),
    "cags-server --bundle {bundle} --port {busy}": (1, "another --port"),
    "cags-server --bundle {bundle} --host 256.1.1.1 --token t": (1, "--host"),
    "cags-shaper --to 127.0.0.1:1 --listen 127.0.0.1:{busy} {steady}": (1, "another port"),
}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """A folder of things that are wrong, and a port that is taken."""
    from cags_encoder.cli import main

    folder = tmp_path_factory.mktemp("wrong")
    bundle = folder / "good.cags"
    assert main(["procedural:size=500,frames=1", str(bundle), "--lod-order", "paper"]) == 0
    old = folder / "old"
    old.mkdir()
    manifest = json.loads((bundle / "manifest.json").read_text(encoding="utf-8"))
    (old / "manifest.json").write_text(json.dumps({**manifest, "version": 99}), encoding="utf-8")
    (folder / "empty").mkdir()
    full = folder / "full"
    full.mkdir()
    (full / "letter.txt").write_text("do not lose me\n", encoding="utf-8")
    (folder / "notes.txt").write_text("nonsense\n", encoding="utf-8")
    (folder / "broken.ply").write_text("not a ply\n", encoding="utf-8")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        names = {name: str(folder / name) for name in ("empty", "full", "old")}
        yield {
            **names,
            "bundle": str(bundle),
            "busy": str(taken.getsockname()[1]),
            "folder": str(folder),
            "nobody": NOBODY,
            "steady": STEADY,
        }


@pytest.fixture
def run(place: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> Callable[[str], int]:
    """Runs a line in that folder, in this process: fifty starts of Python would take a minute."""
    monkeypatch.chdir(place["folder"])
    monkeypatch.setenv("XDG_CACHE_HOME", str(Path(place["folder"]) / "cache"))

    def call(line: str) -> int:
        command, *arguments = line.format(**place).split()
        try:
            return int(import_module(MODULES[command]).main(arguments))
        except SystemExit as end:
            return int(end.code or 0)

    return call


@pytest.mark.parametrize("line", WRONG)
def test_wrong_use_is_one_line_with_a_way_out(
    line: str, run: Callable[[str], int], capfd: pytest.CaptureFixture[str]
) -> None:
    code, way_out = WRONG[line]
    assert run(line) == code
    out, err = capfd.readouterr()
    assert out == ""
    assert err.count("\n") == 1, err
    assert err.startswith(line.split(maxsplit=1)[0]), err
    assert way_out in err
    assert len(err) < 300


def test_the_letter_is_still_there(run: Callable[[str], int], place: dict[str, str]) -> None:
    run("cags-encode procedural:size=500,frames=1 {full}")
    assert (Path(place["full"]) / "letter.txt").read_text(encoding="utf-8") == "do not lose me\n"
