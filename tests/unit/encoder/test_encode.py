from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from cags_common.bundle import BundlePlayer, BundleReader, SourceFrame
from cags_common.errors import CagsError, ConfigError, SceneError
from cags_common.splats import Splats
from cags_encoder import EncodeSettings, encode
from cags_encoder.cli import main
from cags_encoder.execution.executors import InlineExecutor, Workers
from cags_encoder.formats import write_splats
from cags_encoder.scenes import open_scene
from cags_encoder.tracks.effect import visible_effect
from support.codec_scenes import cloud, with_changes

FAST = EncodeSettings(train_splats=1000)


def moving(frames: int = 6, n: int = 400, sh_degree: int = 0) -> list[Splats]:
    """The first quarter drifts slowly, the second changes colour abruptly in frame 3, and the rest stands still."""
    first, out = cloud(n, 5, sh_degree), []
    quarter = n // 4
    for i in range(frames):
        means, sh0 = first.means.copy(), first.sh0.copy()
        means[:quarter, 0] += np.float32(0.002) * i
        if i >= 3:
            sh0[quarter : 2 * quarter] *= -1
        out.append(with_changes(first, means=means, sh0=sh0))
    return out


def by_place(frame: SourceFrame) -> Splats:
    return frame.splats.take(np.lexsort(frame.splats.means.T))


def test_source_frames_are_what_was_given_bit_by_bit(tmp_path: Path) -> None:
    frames = moving(sh_degree=1)
    manifest = encode(frames, FAST, str(tmp_path / "out"))
    reader = BundleReader.open(str(tmp_path / "out"))
    assert (manifest.frames, manifest.sh_degree, manifest.gof_starts) == (6, 1, (0,))
    for index, given in enumerate(frames):
        expected = given.checked("x").take(np.lexsort(given.means.T))
        for (name, a), (_, b) in zip(by_place(reader.source(index)).arrays(), expected.arrays(), strict=True):
            assert np.array_equal(a, b), (index, name)


def test_what_the_decoder_holds_never_drifts(tmp_path: Path) -> None:
    frames = moving(30)
    encode(frames, FAST, str(tmp_path / "out"))
    reader = BundleReader.open(str(tmp_path / "out"))
    player = BundlePlayer(reader)
    first = visible_effect(player.frame(0).splats, reader.source(0).splats)
    for index in (1, 10, 29):
        shown, true = player.frame(index), reader.source(index)
        assert np.array_equal(shown.ids, true.ids)
        excess = visible_effect(shown.splats, true.splats) - first.max()
        assert excess.max() <= FAST.change_threshold


def test_a_unit_of_length_changes_no_level(tmp_path: Path) -> None:
    levels = []
    for unit in (1.0, 1e-5):
        splats = cloud(200, 3)
        log_scales = splats.log_scales + np.float32(np.log(unit))
        scaled = with_changes(splats, means=splats.means * np.float32(unit), log_scales=log_scales)
        manifest = encode([scaled], replace(FAST, position_step=1 / 256), str(tmp_path / f"{unit}"))
        levels.append(manifest)
        assert manifest.near < manifest.focus_radius / 5
    # Codebooks of log scales are half floats, which are coarser farther from zero. That shows from 64 dB on, next
    # to the 65 dB at which ladders end; positions are exact enough to get there.
    common = min(len(manifest.lod_order) for manifest in levels)
    assert levels[0].lod_order[:common] == levels[1].lod_order[:common]
    for manifest in levels:
        assert len(manifest.lod_order) <= common + 1
        assert manifest.base_psnr_db is not None
        assert manifest.base_psnr_db + sum(manifest.lod_gains_db[:common]) > 64.0


@pytest.mark.parametrize("count", [1, 5])
def test_splats_at_one_point_have_a_picture(count: int, tmp_path: Path) -> None:
    shape = np.ones((count, 3))
    splats = with_changes(
        cloud(count, 3), means=shape, log_scales=-4 * shape, sh0=shape, logit_opacities=np.full(count, 3)
    )
    encode([splats], FAST, str(tmp_path / "out"))
    picture = cv2.imread(str(tmp_path / "out" / "thumbnail.jpg"))
    if picture is None:
        pytest.skip("no thumbnail was drawn: the native kernels are not installed")
    lit = picture.max(axis=2) > 20
    assert 0.05 < lit.mean() < 0.5
    assert not (lit[0].any() or lit[:, 0].any() or lit[-1].any() or lit[:, -1].any()), "it is seen whole"


def test_only_what_changed_is_sent(tmp_path: Path) -> None:
    encode(moving(6, 400), replace(FAST, motion="none"), str(tmp_path / "out"))
    reader = BundleReader.open(str(tmp_path / "out"))
    sent = [sum(tile.splats for tile in reader.frame(i).tiles) for i in range(6)]
    assert sent[0] == 400
    assert sent[3] >= 90
    assert max(sent[1], sent[2], sent[4]) <= 100


@pytest.mark.parametrize("step", [None, 4.0])
def test_a_static_scene_sends_nothing_after_its_first_frame(step: float | None, tmp_path: Path) -> None:
    """Motion does not refine coarse positions of what is at rest."""
    splats = cloud(300)
    encode([splats] * 4, replace(FAST, position_step=step), str(tmp_path / "out"))
    reader = BundleReader.open(str(tmp_path / "out"))
    assert [len(reader.frame(i).tiles) for i in range(4)] == [1, 0, 0, 0]
    assert [reader.frame(i).size_bytes for i in range(1, 4)] == [0, 0, 0]
    assert np.array_equal(BundlePlayer(reader).frame(3).splats.means, BundlePlayer(reader).frame(0).splats.means)


def test_splats_that_come_and_go(tmp_path: Path) -> None:
    whole = cloud(500)
    frames = [whole.take(np.arange(a, b)) for a, b in ((0, 400), (0, 500), (100, 500), (50, 450))]
    encode(frames, FAST, str(tmp_path / "out"))
    reader = BundleReader.open(str(tmp_path / "out"))
    player = BundlePlayer(reader)
    for index, given in enumerate(frames):
        shown = player.frame(index)
        assert len(shown.ids) == len(given)
        assert np.array_equal(shown.ids, reader.source(index).ids)
        assert not np.isin(reader.removed_ids(index), shown.ids).any()
    assert reader.manifest.capacity[0] <= 550, "ids of splats that went are used again"


def test_groups_begin_where_due_and_where_nothing_connects(tmp_path: Path) -> None:
    a, b = cloud(300, 1), cloud(300, 2)
    b = with_changes(b, means=b.means + 100)
    settings = EncodeSettings(train_splats=1000, gof_frames=2)
    assert encode([a, a, a, b, b], settings, str(tmp_path / "out")).gof_starts == (0, 2, 3)


def test_the_same_input_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        encode(moving(), FAST, str(tmp_path / name))
    for file in sorted(p for p in (tmp_path / "a").rglob("*") if p.is_file()):
        assert file.read_bytes() == (tmp_path / "b" / file.relative_to(tmp_path / "a")).read_bytes(), file.name


def test_each_lod_is_nearer_to_the_truth_in_what_it_refines(tmp_path: Path) -> None:
    encode([cloud(2000, 3, 2)], FAST, str(tmp_path / "out"))
    reader = BundleReader.open(str(tmp_path / "out"))
    true = reader.source(0).splats
    errors = [
        sum(float(np.square(a - b).mean()) for (_, a), (_, b) in zip(s.arrays(), true.arrays(), strict=True))
        for s in (BundlePlayer(reader, lod).frame(0).splats for lod in (0, 8, reader.manifest.lods - 1))
    ]
    assert errors[0] > errors[1] > errors[2]


def test_frames_of_different_sh_degrees_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="frame 1: SH degree 1"):
        encode([cloud(20), cloud(20, 0, 1)], FAST, str(tmp_path / "out"))
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(SceneError, match="there are no frames"):
        encode([], FAST, str(tmp_path / "out"))


def test_an_order_from_a_file(tmp_path: Path) -> None:
    paper = EncodeSettings(train_splats=1000, lod_order="paper")  # a measured order leaves out what nobody sees
    manifest = encode([cloud(300)], paper, str(tmp_path / "out"))
    reverse = sorted(manifest.lod_order, key=lambda item: (item.layer, item.attribute))
    lines = tmp_path / "order.txt"
    lines.write_text("# attribute layer\n" + "\n".join(f"{item.attribute} {item.layer}" for item in reverse))
    settings = EncodeSettings(train_splats=1000, lod_order=str(lines))
    assert list(encode([cloud(300)], settings, str(tmp_path / "out")).lod_order) == reverse
    lines.write_text("scale 2")
    with pytest.raises(ConfigError, match="expected layer 1"):
        encode([cloud(300)], settings, str(tmp_path / "out"))


def test_the_command_says_what_is_wrong_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path / "nothing.ply"), str(tmp_path / "out")]) == 1
    assert main(["procedural:size=1000", str(tmp_path / "out"), "--gof-frames", "0"]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 2
    assert "nothing.ply" in lines[0] and "gof_frames = 0" in lines[1]
    assert list(tmp_path.iterdir()) == []


def test_every_error_of_a_wrong_place_is_ours(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(CagsError):
        encode([cloud(20)], FAST, str(tmp_path / "file" / "out"))


class Noting(InlineExecutor):
    """Notes which tasks workers get."""

    def __init__(self) -> None:
        self.tasks: list[str] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.tasks.append(fn.__name__)
        return super().submit(fn, *args, **kwargs)


def test_frames_of_a_still_scene_are_not_passed_between_processes(tmp_path: Path) -> None:
    write_splats(tmp_path / "a.ply", cloud(300, 5))
    (tmp_path / "clip").mkdir()
    for number in range(8):
        write_splats(tmp_path / "clip" / f"{number}.ply", cloud(300, 5))
    still, clip = Noting(), Noting()
    for name, scene, executor in (("one", "a.ply:frames=8", still), ("many", "clip", clip)):
        settings = replace(FAST, gof_frames=5)
        encode(open_scene(f"{tmp_path}/{scene}"), settings, str(tmp_path / name), workers=Workers(executor, 2))
    assert {"look", "read"} <= set(clip.tasks) and not {"look", "read"} & set(still.tasks)
    bundles = [BundleReader.open(str(tmp_path / name)) for name in ("one", "many")]
    assert bundles[0].manifest.gofs == bundles[1].manifest.gofs
