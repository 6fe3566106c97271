"""Publishing: where a folder may be written, and what is left when it fails."""

import shutil
from pathlib import Path

import pytest

from cags_common.errors import BundleError, ConfigError, OutputError
from cags_encoder.bundles.publish import Published, publish
from cags_encoder.cli import main
from support.small_bundles import small_bundle


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_bundle(tmp_path_factory.mktemp("bundles") / "a.cags")


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.rglob("*"))


def test_a_new_and_an_empty_folder_get_the_same(bundle: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    told = [publish(str(bundle), tmp_path / name, None) for name in ("deep/new", "empty")]
    assert names(tmp_path / "deep/new") == names(tmp_path / "empty")
    assert {"manifest.json", "manifest.json.gz"} < set(names(tmp_path / "empty"))
    assert told[1] == Published(str(tmp_path / "empty"), len(names(tmp_path / "empty")), told[0].bytes, False)
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["new"]


def test_a_folder_with_files_and_a_file_are_refused(
    bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "file"
    file.write_text("mine")
    with pytest.raises(ConfigError, match="is not empty; give an empty or a new folder"):
        publish(str(bundle), tmp_path, None)
    assert main(["--publish", str(bundle), str(file)]) == 2
    error = capsys.readouterr().err
    assert f"publish = {file}: is a file; give an empty or a new folder" in error and error.count("\n") == 1
    with pytest.raises(OutputError, match="cannot be written"):
        publish(str(bundle), file / "site", None)
    assert file.read_text() == "mine" and names(tmp_path) == ["file"]


@pytest.mark.parametrize("place", ["b/site", "b/deep/site", "b/../b/site", "link/site", "b/source/site"])
def test_a_folder_inside_the_bundle_is_refused(place: str, bundle: Path, tmp_path: Path) -> None:
    """A bundle that holds other files is not replaced, so ``cags-encode`` would refuse to encode it again."""
    shutil.copytree(bundle, tmp_path / "b")
    (tmp_path / "link").symlink_to(tmp_path / "b")
    before = names(tmp_path / "b")
    for url in (str(tmp_path / "b"), f"file://{tmp_path / 'link'}"):
        with pytest.raises(ConfigError, match=r"lies inside the bundle .*; give a folder outside of it"):
            publish(url, tmp_path / place, None)
    assert names(tmp_path / "b") == before
    publish(str(tmp_path / "b"), tmp_path / "bsite", None)


@pytest.mark.parametrize("there", [True, False])
@pytest.mark.parametrize("lost", ["manifest.json", "codebooks.bin", "gof_0000.bin"])
def test_a_bundle_that_is_not_whole_leaves_nothing(lost: str, there: bool, bundle: Path, tmp_path: Path) -> None:
    shutil.copytree(bundle, tmp_path / "b")
    (tmp_path / "b" / lost).unlink()
    site = tmp_path / "sites" / "site"
    (site if there else site.parent).mkdir(parents=True)
    with pytest.raises(BundleError, match=lost):
        publish(str(tmp_path / "b"), site, None)
    assert names(tmp_path / "sites") == (["site"] if there else [])


@pytest.mark.parametrize("command", [["--inspect"], ["--verify"], ["--publish"]])
def test_a_published_folder_is_told_from_a_bundle(
    command: list[str], bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was said to lack its codebooks, and perhaps not to be made by cags-encode."""
    publish(str(bundle), tmp_path / "site", None)
    into = [str(tmp_path / "other")] if command == ["--publish"] else []
    assert main([*command, str(tmp_path / "site"), *into]) == 1
    said = capsys.readouterr().err
    assert f"{tmp_path / 'site'}: is a folder made by cags-encode --publish, for web hosts; name the bundle" in said
    assert not (tmp_path / "other").exists()
