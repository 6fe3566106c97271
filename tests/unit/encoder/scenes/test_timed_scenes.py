"""Scenes from 4D files."""

import pickle
from pathlib import Path

import numpy as np
import pytest

from cags_common.errors import ConfigError, SceneError
from cags_encoder.formats import write_splats
from cags_encoder.scenes import open_scene
from support.splat_files import random_splats
from support.timed_files import spacetime_ply_bytes, splatv_bytes, timed_splats

TIMED = timed_splats(200)


@pytest.fixture(params=["clip.ply", "clip.splatv"])
def path(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    file = tmp_path / request.param
    file.write_bytes((spacetime_ply_bytes if file.suffix == ".ply" else splatv_bytes)(TIMED))
    return file


def test_frames_are_sampled_at_the_rate_asked_for(path: Path) -> None:
    assert len(open_scene(str(path))) == 50
    scene = open_scene(f"{path}:duration=2,fps=20,up=y")
    assert (len(scene), scene.fps, scene.up, scene.name) == (40, 20.0, (0, 1, 0), "clip")
    rows = TIMED.alive(10 / 40)
    kept = scene.ids(10)
    assert np.abs(len(rows) - len(kept)) <= 2  # rounding to halves and bytes moves some opacities across the limit
    common = np.intersect1d(rows, kept)
    wanted = TIMED.at(10 / 40, common, "x")
    found = scene.frame(10).take(np.searchsorted(kept, common))
    assert found.means == pytest.approx(wanted.means, abs=5e-3)


def test_a_clip_plays_again_beyond_its_end(path: Path) -> None:
    scene = open_scene(f"{path}:duration=0.5,fps=10,frames=12")
    assert len(scene) == 12
    assert scene.ids(7).tolist() == scene.ids(2).tolist()
    assert np.array_equal(scene.frame(11).means, scene.frame(1).means)
    with pytest.raises(IndexError):
        scene.frame(12)


def test_scenes_travel_to_workers_without_their_arrays(path: Path) -> None:
    scene = open_scene(str(path))
    data = pickle.dumps(scene)
    assert len(data) < 2000
    assert np.array_equal(pickle.loads(data).frame(3).means, scene.frame(3).means)


def test_broken_splats_are_left_out_on_request(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(spacetime_ply_bytes(TIMED, motion_0=np.r_[np.nan, np.zeros(len(TIMED) - 1)]))
    with pytest.raises(SceneError, match="motion of splat 0"):
        open_scene(f"{tmp_path}/a.ply")
    assert len(open_scene(f"{tmp_path}/a.ply:repair=drop").frame(0)) > 0


def test_splats_that_leave_the_range_are_left_out_of_that_frame(tmp_path: Path) -> None:
    """Coefficients are finite, and so large that the splat is beyond any limit except at its centre in time."""
    row = int(TIMED.alive(0.0)[0])
    (tmp_path / "a.ply").write_bytes(
        spacetime_ply_bytes(TIMED, motion_8=np.where(np.arange(len(TIMED)) == row, 3e38, 0))
    )
    with pytest.raises(SceneError, match=r"a\.ply: frame 0: .*repair=drop"):
        open_scene(f"{tmp_path}/a.ply")
    scene = open_scene(f"{tmp_path}/a.ply:repair=drop")
    for index in range(len(scene)):
        ids, alive = scene.ids(index), TIMED.alive(index / 50)
        assert len(scene.frame(index)) == len(ids)
        assert set(alive) - {row} <= set(ids) <= set(alive)
    assert row not in scene.ids(0)
    assert len(open_scene(f"motion:{tmp_path}/a.ply:repair=drop,kind=bend").frame(0)) == len(scene.ids(0))


def test_a_duration_is_for_4d_files_alone(tmp_path: Path) -> None:
    write_splats(tmp_path / "a.ply", random_splats())
    with pytest.raises(ConfigError, match=r"duration = 2.0 is for 4D files"):
        open_scene(f"{tmp_path}/a.ply:duration=2")
