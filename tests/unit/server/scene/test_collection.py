"""Several scenes behind one server: found, named, opened when they are watched, and refused when they are not there."""

from __future__ import annotations

import json
import string
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_common.errors import BundleError
from cags_common.raster import create
from cags_server.scene.collection import IDLE_SCENES, Collection, UnknownSceneError, scene_name, unused
from support.small_bundles import small_bundle

RASTERISER = create("auto")
HOSTILE = ["../one", "one/", "", "/etc/passwd", "one\0", "..", "%2e%2e", "ONE"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scenes")
    view = folder / "view.json"
    view.write_text(json.dumps({"title": "The second"}))
    small_bundle(folder / "one.cags")
    small_bundle(folder / "two.cags", frames=3, view=str(view))
    (folder / "broken").mkdir()
    (folder / "broken/manifest.json").write_text("{}")
    (folder / "notes").mkdir()
    return folder


def test_all_bundles_of_a_folder_are_listed(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    scenes = Collection.open(str(folder), lambda: RASTERISER)
    first, second = scenes.entries()
    assert (first.name, first.title, first.frames) == ("one", "splats", 1)
    assert (second.name, second.title, second.frames) == ("two", "The second", 3)
    assert second.seconds == pytest.approx(0.1)
    assert first.bytes > 100
    assert "broken is left out" in caplog.text
    assert scenes.several
    assert scenes.title == "2 scenes"


def test_a_scene_is_named_and_others_are_not_there(folder: Path) -> None:
    scenes = Collection.open(str(folder), lambda: RASTERISER)
    assert scenes.library("one") is scenes.library("one")
    assert scenes.library("two").manifest == scenes.manifest("two")
    for name in HOSTILE:
        with pytest.raises(UnknownSceneError, match="there is no scene"):
            scenes.library(name)
    with pytest.raises(UnknownSceneError, match="a folder of scenes"):
        scenes.manifest(None)


def test_one_bundle_needs_no_name(folder: Path) -> None:
    scenes = Collection.open(str(folder / "one.cags"), lambda: RASTERISER)
    assert not scenes.several
    assert scenes.library(None) is scenes.library("splats")
    with pytest.raises(UnknownSceneError):
        scenes.library("two")


def test_a_folder_without_bundles_is_none_unless_it_may_be_empty(tmp_path: Path) -> None:
    with pytest.raises(BundleError, match=r"has no manifest\.json"):
        Collection.open(str(tmp_path), lambda: RASTERISER)
    scenes = Collection.open(str(tmp_path), lambda: RASTERISER, may_be_empty=True)
    assert scenes.entries() == []
    small_bundle(tmp_path / "late.cags")
    assert scenes.add(tmp_path / "late.cags") == "late"
    assert scenes.add(tmp_path / "late.cags") == "late-2"
    assert [entry.name for entry in scenes.entries()] == ["late", "late-2"]


def test_who_watches_keeps_a_scene_and_idle_ones_are_bounded(folder: Path) -> None:
    scenes = Collection.open(str(folder), lambda: RASTERISER)
    watched = scenes.library("one")
    for number in range(IDLE_SCENES + 2):
        scenes.add(folder / "two.cags")
        scenes.library(f"two-{number + 2}")
    assert scenes.library("one") is watched
    assert len(scenes._idle) == IDLE_SCENES


def test_decoded_tiles_of_a_scene_are_bounded(folder: Path) -> None:
    kept = []
    for most in (1, 1 << 30):
        library = Collection.open(str(folder), lambda: RASTERISER, decoded_bytes=most).library("two")
        for levels in (0b1, 0b11):
            library.decoded.at((0, 0), levels)
        kept.append(library.decoded.nbytes)
    assert kept[0] < kept[1], "the newest one alone"


def test_decoded_tiles_are_dropped_and_made_again(folder: Path) -> None:
    scenes = Collection.open(str(folder), lambda: RASTERISER)
    library = scenes.library("two")
    before = library.decoded.at((0, 0), 0b11)
    assert scenes.decoded_bytes > 0
    scenes.forget_decoded()
    assert scenes.decoded_bytes == 0
    assert library.decoded.at((0, 0), 0b11).nbytes == before.nbytes and library.decoded.made == 2


def test_a_thumbnail_is_the_bundles_or_drawn(folder: Path, tmp_path: Path) -> None:
    scenes = Collection.open(str(folder), lambda: RASTERISER)
    own = (folder / "one.cags/thumbnail.jpg").read_bytes()
    assert scenes.thumbnail("one") == own
    bare = small_bundle(tmp_path / "bare.cags")
    (bare / "thumbnail.jpg").unlink()
    assert Collection.open(str(tmp_path), lambda: RASTERISER).thumbnail("bare") == own, "the same picture"


@given(st.text(max_size=100))
def test_any_text_gives_a_name_for_addresses(text: str) -> None:
    name = scene_name(text)
    assert 0 < len(name) <= 80
    assert set(name) <= set(string.ascii_letters + string.digits + "._-")
    assert name[0] not in ".-"
    assert scene_name(name) == name or name.endswith((".cags", ".bundle"))


def test_names_stay_apart() -> None:
    assert unused("a", {}) == "a"
    assert unused("a", {"a": None, "a-2": None}) == "a-3"  # type: ignore[dict-item]
