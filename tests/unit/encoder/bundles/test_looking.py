"""The output of --inspect, --verify and --export."""

import json
import shutil
from pathlib import Path

import gsply
import numpy as np
import pytest

from cags_common.bundle import BundlePlayer, BundleReader
from cags_common.tiles.kinds import TileKind
from cags_encoder import EncodeSettings, encode
from cags_encoder.cli import main
from cags_encoder.formats import read_splats
from support.codec_scenes import cloud, with_changes


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three frames in two groups; the last moves a part."""
    first = cloud(600, 1, 1)
    moved = with_changes(first, means=first.means + np.float32(0.02) * (np.arange(600) < 100)[:, None])
    out = tmp_path_factory.mktemp("bundles") / "a.cags"
    encode([first, moved, moved], EncodeSettings(train_splats=1000, gof_frames=2), str(out))
    return out


def said(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(list(arguments)) == 0, capsys.readouterr().err
    return capsys.readouterr().out


def test_inspect_says_what_is_there(bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = json.loads(said(capsys, "--inspect", str(bundle), "--json"))
    with BundleReader.open(str(bundle)) as reader:
        manifest, entries = reader.manifest, [reader.frame(k) for k in range(3)]
    sent = [sum(tile.splats for tile in entry.tiles if tile.kind == TileKind.LOOKS) for entry in entries]
    assert [(f["key"], f["splats"]) for f in found["each_frame"]] == list(zip((True, False, True), sent, strict=True))
    assert sent == [600, 0, 600]
    assert [f["bytes"] for f in found["each_frame"]] == [entry.size_bytes for entry in entries]
    every = sum(sum(t.lod_bytes) for e in entries for t in e.tiles)
    assert sum(level["bytes"] for level in found["levels"]) + sum(found["bytes_of"]["motion"]) == every
    assert found["bytes_of"]["motion"][0] > 0 and not found["bytes_of"]["update"]
    assert found["levels"][0]["adds"] == "base" and len(found["levels"]) == manifest.lods
    assert {book["attribute"] for book in found["codebooks"]} >= {"scale", "sh0", "sh1"}
    if manifest.lod_gains_db:
        assert len(found["quality"]["ladder"]) == manifest.lods
    text = said(capsys, "--inspect", str(bundle))
    assert "3 frames at 30 fps in 2 groups" in text and "codebook" in text and "motion tiles: " in text
    assert text.count("\n") > manifest.lods
    size = entries[0].size_bytes
    assert found["bytes_a_splat"] == size / 600
    assert f"first frame: 600 splats, {size} bytes ({size / 600:.2f} a splat); " in text
    assert sum(level["first_frame_bytes"] for level in found["levels"]) < size, "motion is there, too"
    assert "bytes of each level, without motion:" in text
    assert (found["tracks"]["frames"], found["tracks"]["tracks"], found["tracks"]["linked_share"]) == (3, 600, 1.0)
    assert "tracks: 600, seen in 3.0 frames on average; 100.0% of a frame's splats continue" in text
    assert "lifetimes in frames: 2+: 600" in text
    shift = found["tracks"]["changed"]["position"]
    assert 0.04 < shift <= 1 / 12  # a sixth moves in one of two frames; part of it is too faint to be visible
    assert f"position {shift:.1%}, rotation 0.0%, scale 0.0%" in text


def test_inspect_says_what_bytes_tell(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first = cloud(600, 1, 1)
    some = (np.arange(600) < 100)[:, None]
    away = np.random.default_rng(3).uniform(0.01, 0.03, (600, 3)).astype(np.float32) * some
    second = with_changes(first, means=first.means + away, sh0=first.sh0 + np.float32(0.3) * some)
    encode([first, second, cloud(650, 2, 1)], EncodeSettings(train_splats=1000), str(tmp_path / "a.cags"))
    found = json.loads(said(capsys, "--inspect", str(tmp_path / "a.cags"), "--json"))
    with BundleReader.open(str(tmp_path / "a.cags")) as reader:
        entries = [reader.frame(k) for k in range(3)]
    for kind in TileKind:
        tiles = [t for e in entries for t in e.tiles if t.kind == kind and not (e.keyframe and kind == TileKind.LOOKS)]
        parts = found["bytes_by_part"].get(kind.name.lower(), {})
        whole = sum(sum(tile.lod_bytes) for tile in tiles)
        assert abs(sum(parts.values()) - whole) <= len(parts) * (kind == TileKind.MOTION)  # shares of a sample, rounded
    assert found["bytes_by_part"]["update"]["sh0, finer"] > 0
    assert found["bytes_by_part"]["motion"]["positions, level 0"] > 0
    assert "update after key frames: heads " in said(capsys, "--inspect", str(tmp_path / "a.cags"))


@pytest.mark.parametrize("name", ["plot.png", "plot.svg"])
def test_a_plot_is_drawn(bundle: Path, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said(capsys, "--inspect", str(bundle), "--plot", str(tmp_path / name))
    assert (tmp_path / name).stat().st_size > 10_000
    assert main(["--inspect", str(bundle), "--plot", str(tmp_path / "plot.xyz")]) == 1
    assert "plot.xyz: is no kind of picture" in capsys.readouterr().err


def test_a_whole_bundle_verifies(bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "intact: 3 frames" in said(capsys, "--verify", str(bundle))


@pytest.mark.parametrize(
    ("file", "at", "named"),
    [
        ("gof_0000.bin", 40, "frame 0, tile 0, LoD 0: CRC-32"),
        ("gof_0001.bin", 2000, "frame 2, tile 0, LoD"),
        ("gof_0000.bin", -20, "gof_0000.bin: its index is damaged"),
        ("source/gof_0000.bin", 30, "source frame 0: CRC-32"),
        ("source/gof_0000.bin", -3000, "source frame 1: is not valid gzip data"),
        ("quality.json", 5, "quality.json: is damaged"),
        ("thumbnail.jpg", 0, "thumbnail.jpg: is damaged"),
    ],
)
def test_a_flipped_bit_is_found_and_its_place_named(
    bundle: Path, file: str, at: int, named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "broken"
    shutil.copytree(bundle, broken)
    if not (broken / file).exists():
        pytest.skip("levels were not measured: the native kernels are not installed")
    data = bytearray((broken / file).read_bytes())
    data[at] ^= 0x10
    (broken / file).write_bytes(data)
    assert main(["--verify", str(broken)]) == 1
    error = capsys.readouterr().err
    lines = [line for line in error.splitlines() if line.strip()]  # the progress bar prints an empty line
    assert len(lines) == 1 and named in lines[0] and str(broken) in lines[0]


def test_export_for_an_independent_reader(bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with BundleReader.open(str(bundle)) as reader:
        top, low = BundlePlayer(reader).frame(1).splats, BundlePlayer(reader, 3).frame(1).splats
    ply, spz, coarse = tmp_path / "a.ply", tmp_path / "a.spz", tmp_path / "low.ply"
    assert "600 splats as ply" in said(capsys, "--export", str(bundle), "1", str(ply))
    said(capsys, "--export", str(bundle), "1", str(spz))
    said(capsys, "--export", str(bundle), "1:3", str(coarse))
    theirs, packed = gsply.plyread(str(ply)), gsply.read_spz(str(spz))
    np.testing.assert_array_equal(theirs.means, top.means)
    np.testing.assert_array_equal(theirs.scales, top.log_scales)
    np.testing.assert_array_equal(theirs.sh0, top.sh0)
    np.testing.assert_array_equal(gsply.plyread(str(coarse)).scales, low.log_scales)
    np.testing.assert_allclose(packed.means, top.means, atol=1e-4)
    assert np.abs(packed.scales - np.clip(top.log_scales, -10, 6)).max() <= 1 / 32 + 1e-5
    assert read_splats(ply)[0].sh_degree == 1


@pytest.mark.parametrize(
    ("arguments", "code", "word"),
    [
        (["--export", "B", "x", "o.ply"], 2, "'x' must be FRAME or FRAME:LOD"),
        (["--export", "B", "7", "o.ply"], 1, "frame 7 is outside"),
        (["--export", "B", "0:99", "o.ply"], 1, "LoD 99 is outside"),
        (["--export", "B", "0", "o.glb"], 1, "'.glb' is unknown"),
        (["--verify", "nowhere"], 1, "no such folder"),
        (["--inspect", "B", "scene.ply"], 2, "takes no SCENE"),
        (["--plot", "x.png", "a", "b"], 2, "--inspect BUNDLE"),
        (["only-a-scene"], 2, "SCENE and OUT are needed"),
    ],
)
def test_wrong_use_is_one_line(
    arguments: list[str], code: int, word: str, bundle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([str(bundle) if part == "B" else part for part in arguments]) == code
    error = capsys.readouterr().err
    assert word in error and error.count("\n") == 1
