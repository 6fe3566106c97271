"""Splats that cannot be drawn are refused with their name, or left out and counted."""

import logging
from pathlib import Path

import numpy as np
import pytest

from cags_common.errors import SceneError
from cags_common.splats import Splats
from cags_encoder import EncodeSettings, encode
from cags_encoder.formats.ply import ply_bytes
from cags_encoder.formats.repair import DropBroken, drawable
from cags_encoder.scenes import open_scene
from support.codec_scenes import cloud, with_changes

BROKEN = (3, 7, 11, 20, 25)


def broken(splats: Splats) -> Splats:
    """NaN, infinities, a zero-length rotation and a huge colour in five rows; a legal infinite logit in another."""
    means, scales, quats, logits, sh0 = (
        getattr(splats, name).copy() for name in ("means", "log_scales", "quats", "logit_opacities", "sh0")
    )
    means[3, 1], scales[7, 0], quats[11], logits[20], logits[21], sh0[25] = np.nan, np.inf, 0, np.nan, np.inf, 1e30
    return with_changes(splats, means=means, log_scales=scales, quats=quats, logit_opacities=logits, sh0=sh0)


def test_what_can_be_drawn() -> None:
    assert np.flatnonzero(~drawable(broken(cloud(30)))).tolist() == list(BROKEN)


def test_a_file_is_refused_or_its_broken_splats_left_out_and_counted(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "a.ply"
    path.write_bytes(ply_bytes(broken(cloud(30))))
    with pytest.raises(SceneError, match=r"means\[3\]\[1\] = nan is not finite; repair the file"):
        open_scene(str(path))
    with caplog.at_level(logging.WARNING):
        scene = open_scene(f"{path}:repair=drop")
    assert "a.ply: left out 5 of 30 splats" in caplog.text
    ids = scene.ids(0)
    assert ids is not None and ids.tolist() == [row for row in range(30) if row not in BROKEN]
    assert np.array_equal(scene.frame(0).means, cloud(30).means[ids])


def test_rows_keep_their_identity_when_others_are_left_out(tmp_path: Path) -> None:
    whole = cloud(200)
    for k, splats in enumerate((whole, broken(whole), whole)):
        (tmp_path / f"{k}.ply").write_bytes(ply_bytes(splats))
    manifest = encode(open_scene(f"{tmp_path}:repair=drop,rows=keep"), EncodeSettings(train_splats=500), "memory://r")
    assert manifest.gof_starts == (0,) and manifest.capacity[0] <= 200 + len(BROKEN)


def test_an_archive_over_time(tmp_path: Path) -> None:
    means = np.random.default_rng(0).normal(size=(2, 10, 3)).astype(np.float32)
    means[1, 4] = np.nan
    path = tmp_path / "params.npz"
    np.savez(
        path,
        means3D=means,
        rgb_colors=np.full((2, 10, 3), 0.5, np.float32),
        unnorm_rotations=np.tile(np.array([1, 0, 0, 0], np.float32), (2, 10, 1)),
        log_scales=np.full((10, 3), -3, np.float32),
        logit_opacities=np.zeros((10, 1), np.float32),
    )
    scene = open_scene(f"{path}:repair=drop")
    assert [len(scene.frame(k)) for k in (0, 1)] == [10, 9]
    ids = scene.ids(1)
    assert ids is not None and ids.tolist() == [0, 1, 2, 3, 5, 6, 7, 8, 9]


def test_a_file_of_nothing_else_is_refused() -> None:
    nothing = with_changes(cloud(5), means=np.full((5, 3), np.nan))
    with pytest.raises(SceneError, match="all of its 5 splats have invalid values"):
        DropBroken()(nothing, "x")
