"""Errors of a bundle name it, and ``docs/bundle.md`` states the versions that are read."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from cags_bench.sim.bundle import open_bundle
from cags_common.bundle import BundleReader
from cags_common.bundle.manifest import VERSION
from cags_common.errors import BundleError, DecodeError
from cags_common.motion import chunk
from cags_common.tiles.payloads import BASE_VERSION
from cags_common.tiles.updates import UPDATE_VERSION
from cags_encoder.bundles.publish import publish
from cags_encoder.cli import main
from support.small_bundles import small_bundle

PAGE = Path(__file__).parents[4] / "docs" / "bundle.md"


@pytest.fixture
def bundle(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A bundle in the current folder, whose name begins what its manifest's errors begin with."""
    monkeypatch.chdir(tmp_path)
    small_bundle(tmp_path / "m")
    return "m"


def outdated(manifest: Path) -> None:
    manifest.write_text(json.dumps(json.loads(manifest.read_text()) | {"version": 4}))


def test_a_damaged_manifest_names_the_bundle_and_the_way_out(bundle: str) -> None:
    Path(bundle, "manifest.json").write_text("{")
    with pytest.raises(BundleError, match=r"^m: manifest: is not JSON \(.*\); encode the scene again$"):
        BundleReader.open(bundle)


def test_an_old_bundle_names_itself_and_the_way_out_once(bundle: str) -> None:
    outdated(Path(bundle, "manifest.json"))
    with pytest.raises(BundleError, match=rf"^m: manifest: version 4 .* reads {VERSION}, encode again$"):
        BundleReader.open(bundle)


def test_damaged_codebooks_name_the_bundle(bundle: str) -> None:
    Path(bundle, "codebooks.bin").write_bytes(b"nothing")
    with pytest.raises((BundleError, DecodeError), match=r"^m: .*; encode the scene again$"):
        BundleReader.open(bundle)


def test_a_bundle_that_is_not_there_is_named_once(bundle: str) -> None:
    with pytest.raises(BundleError, match=r"^no: no such folder; cags-encode makes bundles$"):
        BundleReader.open("no")


def test_a_published_folder_is_named(bundle: str) -> None:
    publish(bundle, Path("site"), None)
    outdated(Path("site/manifest.json"))
    with pytest.raises(BundleError, match=r"^site: manifest: version 4"):
        open_bundle(Path("site"))


@pytest.mark.parametrize("command", [["--inspect"], ["--verify"], ["--publish", "site"]])
def test_the_encoder_names_a_damaged_bundle_once(
    bundle: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], command: list[str]
) -> None:
    Path(bundle, "manifest.json").write_text("{")
    bundle = str(tmp_path / bundle)
    flag, *rest = command
    assert main([flag, bundle, *rest]) == 1
    (said,) = capsys.readouterr().err.splitlines()
    assert said.startswith(f"cags-encode: {bundle}: manifest: is not JSON") and said.count(bundle) == 1


def test_the_page_states_the_versions_that_are_read() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert f"# Bundle format, version {VERSION}\n" in text
    assert f"`cags-bundle` and {VERSION};" in text
    assert f"| version ({chunk.VERSION}), flags" in text
    found = re.search(r"The first byte identifies a LoD 0 payload: (\d+) looks, (\d+) motion, (\d+) update\.", text)
    assert found is not None
    assert tuple(map(int, found.groups())) == (BASE_VERSION, chunk.VERSION, UPDATE_VERSION)
