"""The author's view, stored in a bundle during or after encoding."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cags_common.bundle import BundleReader
from cags_encoder.cli import main
from support.small_bundles import small_bundle


def view_file(path: Path, **parts: object) -> str:
    path.write_text(json.dumps(parts))
    return str(path)


def test_a_view_is_kept_at_encoding(tmp_path: Path) -> None:
    bundle = small_bundle(tmp_path / "a", view=view_file(tmp_path / "view.json", title="Balls"))
    with BundleReader.open(str(bundle)) as reader:
        assert reader.manifest.view is not None
        assert reader.manifest.view.title == "Balls"
        assert (reader.thumbnail() or b"")[:2] == b"\xff\xd8"


def test_a_view_is_given_to_a_bundle_that_is_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bundle = small_bundle(tmp_path / "a")
    before = {path.name: path.read_bytes() for path in bundle.iterdir() if path.is_file()}
    view = view_file(tmp_path / "view.json", title="Later", background="#FF0000")
    assert main(["--set-view", str(bundle), view, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["view"] == {"title": "Later", "background": "#ff0000"}
    with BundleReader.open(str(bundle)) as reader:
        assert reader.manifest.view is not None
        assert reader.manifest.view.background == "#ff0000"
        assert reader.thumbnail() != before["thumbnail.jpg"]
    after = {path.name: path.read_bytes() for path in bundle.iterdir() if path.is_file()}
    assert {name for name in after if after[name] != before[name]} == {"manifest.json", "thumbnail.jpg"}


def test_a_wrong_view_stops_before_the_work(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    view = view_file(tmp_path / "view.json", radius=-1)
    assert main(["procedural:size=500,frames=1", str(tmp_path / "a"), "--view", view]) == 2
    assert "radius = -1 must be a number" in capsys.readouterr().err
    assert main(["--set-view", str(tmp_path / "a"), view, "--view", view]) == 2
    assert "leave it out with --set-view" in capsys.readouterr().err
    assert not (tmp_path / "a").exists()
