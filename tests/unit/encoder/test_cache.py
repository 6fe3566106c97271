"""Keys change with what a bundle's bytes depend on, and with nothing else."""

import os
from dataclasses import replace
from pathlib import Path

import pytest

from cags_common.errors import ConfigError
from cags_encoder import EncodeSettings, content_key
from cags_encoder.cache import resume_folder

SETTINGS = EncodeSettings()


def test_scenes_files_and_settings_are_told_apart(tmp_path: Path) -> None:
    scene = tmp_path / "a.ply"
    scene.write_bytes(b"x")
    key = content_key(str(scene), SETTINGS)
    assert key == content_key(str(scene), SETTINGS) != content_key(str(scene), EncodeSettings(seed=1))
    scene.write_bytes(b"xy")
    assert key != content_key(str(scene), SETTINGS)
    assert content_key("procedural:size=10", SETTINGS) != content_key("procedural:size=11", SETTINGS)


@pytest.mark.parametrize("spec", ["{}", "{}:frames=3", "motion:{}:kind=bend", "motion:{}"])
def test_the_file_of_a_spec_is_found(tmp_path: Path, spec: str) -> None:
    scene = tmp_path / "a.ply"
    scene.write_bytes(b"x")
    key = content_key(spec.format(scene), SETTINGS)
    scene.write_bytes(b"xy")
    assert content_key(spec.format(scene), SETTINGS) != key


def test_a_folder_of_a_generated_scenes_name_does_not_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    key = content_key("procedural:size=10", SETTINGS)
    (tmp_path / "procedural").mkdir()
    assert content_key("procedural:size=10", SETTINGS) == key


@pytest.mark.parametrize("setting", ["lod_order", "view"])
def test_of_files_that_settings_name_the_content_counts(tmp_path: Path, setting: str) -> None:
    first, second = {"lod_order": ("scale 1\nopacity 1", "opacity 1\nscale 1"), "view": ('{"title": "a"}', "{}")}[
        setting
    ]
    file, copy = tmp_path / "file", tmp_path / "copy"
    file.write_text(first)
    copy.write_text(f"{first}\n")
    key = content_key("procedural", replace(SETTINGS, **{setting: str(file)}))
    assert content_key("procedural", replace(SETTINGS, **{setting: str(copy)})) == key
    file.write_text(second)
    assert content_key("procedural", replace(SETTINGS, **{setting: str(file)})) != key
    file.write_text("no such thing")
    with pytest.raises(ConfigError, match="file"):
        content_key("procedural", replace(SETTINGS, **{setting: str(file)}))


def test_pipes_are_left_to_the_encoder_and_differ() -> None:
    """As ``--view <(program)`` names them: what is read of one is gone."""
    keys = set()
    pipes = [os.pipe() for _ in range(2)]
    for out, into in pipes:
        os.write(into, b'{"title": "a"}')
        keys.add(content_key("procedural", replace(SETTINGS, view=f"/dev/fd/{out}")))
        assert os.read(out, 100) == b'{"title": "a"}'
    assert len(keys) == 2
    for end in (end for pipe in pipes for end in pipe):
        os.close(end)


def frames(folder: Path) -> Path:
    for number in range(3):
        (folder / f"frame_{number}.ply").write_bytes(b"x")
    return folder / "frame_1.ply"


def trained(folder: Path) -> Path:
    for iteration in (7000, 30000):
        inner = folder / f"frame1/point_cloud/iteration_{iteration}"
        inner.mkdir(parents=True)
        (inner / "point_cloud.ply").write_bytes(b"x")
    return inner / "point_cloud.ply"


def unbundled(folder: Path) -> Path:
    (folder / "meta.json").write_text("{}")
    (folder / "means_l.webp").write_bytes(b"x")
    return folder / "means_l.webp"


@pytest.mark.parametrize("layout", [frames, trained, unbundled])
def test_of_a_folder_only_what_the_scene_reads_counts(tmp_path: Path, layout) -> None:
    read = layout(tmp_path)
    key = content_key(str(tmp_path), SETTINGS)
    for other in (".out.cags.encoding/frame_000000.npz", ".out.cags.partial-7/gof_0000.bin", "out.cags/manifest.json"):
        (tmp_path / other).parent.mkdir()
        (tmp_path / other).write_bytes(b"x")
    (tmp_path / ".frame_0.ply.part").write_bytes(b"x")
    assert content_key(str(tmp_path), SETTINGS) == key
    read.write_bytes(b"xy")
    assert content_key(str(tmp_path), SETTINGS) != key


def test_records_lie_beside_what_a_link_points_to(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere" / "real")
    records = tmp_path.resolve() / "elsewhere" / ".real.encoding"
    for url in (f"{tmp_path}/link", f"file://{tmp_path}/link", f"local://{tmp_path}/elsewhere/real"):
        assert resume_folder(url, "key") == records
    assert resume_folder("memory://out", "key").name == "key"
