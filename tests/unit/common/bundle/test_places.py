"""What is replaced by a bundle, what is refused, and what is left of a bundle that was not completed."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any
from uuid import uuid4

import fsspec
import pytest

from cags_common.bundle.places import place_of
from cags_common.errors import BundleError, OutputError

OLD = ("codebooks.bin", "gof_0000.bin", "gof_0001.bin", "source/gof_0000.bin", "weights-0123abcd.npz", "manifest.json")


@pytest.fixture(params=["folder", "file://", "local://", "memory://"])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    if request.param == "memory://":
        return f"memory://{uuid4().hex}/out"
    return f"{'' if request.param == 'folder' else request.param}{tmp_path}/out"


def put(url: str, *names: str) -> None:
    fs, path = fsspec.core.url_to_fs(url)
    for name in names:
        fs.makedirs(f"{path}/{name}".rpartition("/")[0], exist_ok=True)
        fs.pipe_file(f"{path}/{name}", b"old")


def held(url: str) -> dict[str, bytes]:
    fs, path = fsspec.core.url_to_fs(url)
    return {name.removeprefix(path).strip("/"): fs.cat_file(name) for name in fs.find(path)}


def write(url: str, *names: str) -> None:
    place = place_of(url)
    for name in names:
        with place.open(name) as file:
            file.write(b"new")
    place.finish()


@pytest.mark.parametrize("names", [["precious.txt"], ["notes/codebooks.bin"], ["thumbnail.jpg"], ["gof_0000.bin/x"]])
def test_a_folder_that_is_no_bundle_is_refused(url: str, names: list[str]) -> None:
    put(url, *names)
    with pytest.raises(BundleError, match=r"is not a bundle .*give another name"):
        place_of(url)
    assert held(url) == dict.fromkeys(names, b"old")


@pytest.mark.parametrize("foreign", ["precious.txt", "source/precious.txt", "index.html", ".git/config"])
def test_a_bundle_with_somebody_elses_files_is_refused(url: str, foreign: str) -> None:
    put(url, *OLD, foreign)
    with pytest.raises(BundleError, match=f"holds {foreign.replace('config', '')}"):
        place_of(url)
    assert held(url).keys() == {*OLD, foreign}


def test_a_file_is_refused(url: str) -> None:
    put(url.rpartition("/")[0], "out")
    with pytest.raises(BundleError, match="is not a bundle but a file"):
        place_of(url)


def test_a_bundle_is_replaced_as_a_whole(url: str) -> None:
    put(url, *OLD)
    write(url, "codebooks.bin", "gof_0000.bin", "manifest.json")
    assert held(url) == dict.fromkeys(("codebooks.bin", "gof_0000.bin", "manifest.json"), b"new")


def test_nothing_changes_before_the_first_file(url: str) -> None:
    put(url, *OLD)
    place_of(url).discard()
    assert held(url) == dict.fromkeys(OLD, b"old")


def test_only_what_was_written_is_deleted(tmp_path: Path) -> None:
    url = f"memory://{uuid4().hex}/out"
    place = place_of(url)
    place.open("codebooks.bin").write(b"new")
    put(url, "precious.txt")
    place.discard()
    assert held(url) == {"precious.txt": b"old"}


def test_what_came_while_a_bundle_was_written_is_kept(tmp_path: Path) -> None:
    place = place_of(str(tmp_path / "out"))
    with place.open("manifest.json") as file:
        file.write(b"new")
    put(str(tmp_path / "out"), "precious.txt")
    with pytest.raises(BundleError, match="is not a bundle"):
        place.finish()
    place.discard()
    assert [path.name for path in tmp_path.rglob("*")] == ["out", "precious.txt"]


def test_what_a_killed_run_left_on_a_store_is_replaced() -> None:
    url = f"memory://{uuid4().hex}/out"
    put(url, "codebooks.bin", "gof_0000.bin", "gof_0001.bin", "source/gof_0000.bin")
    write(url, "codebooks.bin", "manifest.json")
    assert held(url).keys() == {"codebooks.bin", "manifest.json"}


@pytest.mark.parametrize("there", [True, False])
def test_a_link_stays_a_link_and_its_target_is_written(tmp_path: Path, there: bool) -> None:
    (tmp_path / "elsewhere").mkdir()
    real, link = tmp_path / "elsewhere" / "real", tmp_path / "link"
    if there:
        put(str(real), *OLD)
    link.symlink_to("elsewhere/real")
    write(str(link), "codebooks.bin", "manifest.json")
    assert link.is_symlink()
    assert held(str(real)) == {"codebooks.bin": b"new", "manifest.json": b"new"}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["elsewhere", "link"]
    assert [path.name for path in real.parent.iterdir()] == ["real"]


def test_a_link_to_itself_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out").symlink_to("out")
    with pytest.raises(BundleError, match=r"out: is a symbolic link .*circle"):
        place_of(str(tmp_path / "out"))


@pytest.mark.parametrize("name", ["a/out", "a/source/deep/out"])
def test_a_place_inside_a_bundle_is_refused(tmp_path: Path, name: str) -> None:
    """It was written, and the bundle around it could then not be encoded again."""
    outer = tmp_path / "a"
    outer.mkdir()
    (outer / "manifest.json").write_text("{}")
    assert place_of(str(tmp_path / name))  # whoever keeps a manifest of another kind may work beneath it
    (outer / "codebooks.bin").write_text("")
    with pytest.raises(BundleError, match=r"out: lies inside the bundle .*a, which could not be replaced any more"):
        place_of(str(tmp_path / name))
    assert not (outer / "out").exists()


@pytest.mark.parametrize("name", [".", "..", "{tmp_path}"])
def test_the_current_folder_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    (tmp_path / "within").mkdir()
    monkeypatch.chdir(tmp_path / "within")
    with pytest.raises(BundleError, match="would replace the current folder; name a new folder"):
        place_of(name.format(tmp_path=tmp_path))


def test_a_mount_point_is_refused() -> None:
    with pytest.raises(BundleError, match="/: is a mount point"):
        place_of("/")


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("file/out", "is not a folder; give another name"),
        ("file/below/out", "is not a folder; give another name"),
        ("n" * 300, r"cannot be written \(File name too long\); choose a shorter name"),
    ],
)
def test_a_place_that_cannot_be_written_is_named(tmp_path: Path, name: str, why: str) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises((BundleError, OutputError), match=why) as caught:
        place_of(str(tmp_path / name))
    assert str(caught.value).startswith(f"{tmp_path / name}: ")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def _full(*_: object) -> None:
    raise OSError(28, os.strerror(28))


def _unknown(*_: object) -> None:
    raise RuntimeError("no credentials")


@pytest.mark.parametrize(
    ("fault", "why"),
    [
        (_full, r"cannot be written \(No space left on device\); make room or choose another place"),
        (_unknown, r"cannot be written \(no credentials\); check the address and, for s3, the credentials"),
    ],
)
def test_a_file_that_cannot_be_written_is_named(
    url: str, fault: Callable[..., Any], why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = place_of(url)
    file = place.open("gof_0000.bin")
    file.close()
    monkeypatch.setattr(file, "_file", type("Broken", (), {"write": fault, "close": fault})())
    for call in (lambda: file.write(b"new"), file.close):
        with pytest.raises(OutputError, match=f"out/gof_0000.bin: {why}"):
            call()
    place.discard()
    assert held(url) == {}
