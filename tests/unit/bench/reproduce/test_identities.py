"""Identities that are found once: every encoding is what it would be without."""

from __future__ import annotations

from pathlib import Path

import pytest

from cags_bench.bundles import IdentifiedSource, cached_bundle, identified
from cags_encoder import EncodeSettings
from cags_encoder.formats.ply import ply_bytes
from cags_encoder.scenes import open_scene
from cags_encoder.tracks import identity


@pytest.fixture
def frames(tmp_path: Path) -> str:
    """A folder of frames that know no identities."""
    scene = open_scene("procedural:size=500,frames=4")
    folder = tmp_path / "moving"
    folder.mkdir()
    for at in range(4):
        splats = scene.frame(at)
        turned = splats.take(slice(at * 7, None))  # rows are no identities
        (folder / f"frame_{at:04d}.ply").write_bytes(ply_bytes(turned))
    return str(folder)


def test_a_bundle_is_the_same_with_identities_found_before(frames: str, tmp_path: Path) -> None:
    settings = EncodeSettings(frames=4)
    plain = cached_bundle(frames, str(tmp_path / "plain"), settings, progress=False)
    shared = cached_bundle(
        frames,
        str(tmp_path / "shared"),
        settings,
        progress=False,
        source=lambda: identified(frames, 4, tmp_path / "ids"),
    )
    files = sorted(path.relative_to(plain) for path in plain.rglob("*") if path.is_file())
    assert files
    assert all((plain / name).read_bytes() == (shared / name).read_bytes() for name in files)


def test_identities_are_found_once(frames: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = identified(frames, 4, tmp_path / "ids")
    assert isinstance(first, IdentifiedSource)
    monkeypatch.setattr(identity, "IdentityTracker", None)
    again = identified(frames, 4, tmp_path / "ids")
    assert isinstance(again, IdentifiedSource)
    assert [list(ids) for ids in again.found] == [list(ids) for ids in first.found]


def test_a_scene_that_knows_its_identities_keeps_them(tmp_path: Path) -> None:
    assert not isinstance(identified("procedural:size=500,frames=4", 4, tmp_path), IdentifiedSource)
    assert not list(tmp_path.iterdir())
