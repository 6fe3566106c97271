"""Scenes from files: static scenes, sequences, layouts, identities."""

import pickle
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cags_common.errors import SceneError
from cags_common.splats import Splats
from cags_encoder.formats import write_splats
from cags_encoder.formats.sog_writer import sog_bytes
from cags_encoder.scenes import folders, open_scene
from cags_encoder.scenes.folders import natural_key
from support.splat_files import random_splats, shared_scene, zip_files


def moved(splats: Splats, by: float, count: int | None = None) -> Splats:
    arrays = {name: array.copy() for name, array in splats.arrays()}
    arrays["means"] += np.float32(by)
    return Splats(**arrays).take(slice(0, count))


def save(folder: Path, frames: list[Splats], name: str = "frame_{}.ply") -> None:
    for i, splats in enumerate(frames):
        path = folder / name.format(i)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_splats(path, splats)


def test_a_single_file_is_a_still_scene(tmp_path: Path) -> None:
    write_splats(tmp_path / "plant.v2.ply", random_splats())
    scene = open_scene(str(tmp_path / "plant.v2.ply"))
    assert (scene.name, len(scene)) == ("plant", 60)
    assert scene.frame(0) is scene.frame(59)
    assert scene.ids(3) is not None


def test_numbers_sort_as_numbers(tmp_path: Path) -> None:
    names = ["f10.ply", "f9.ply", "f1b.ply", "f1.ply", "g0.ply"]
    assert sorted(names, key=natural_key) == ["f1.ply", "f1b.ply", "f9.ply", "f10.ply", "g0.ply"]
    save(tmp_path, [moved(random_splats(), i) for i in range(11)])
    scene = open_scene(str(tmp_path))
    assert [round(float(scene.frame(i).means[0, 0] - scene.frame(0).means[0, 0])) for i in (1, 2, 10)] == [1, 2, 10]


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        ((0, 1, 3), "frame 2 is missing between f0001.ply and f0003.ply"),
        ((0, 10, 40, 50, 70), "3 frames are missing, the first of them 20 between f0010.ply and f0040.ply"),
        ((7, 8, 9), ""),
        ((0, 10, 20), ""),
        ((3, 9), ""),
        ((1000, 1033, 1066, 1100), ""),
        ((5,), ""),
    ],
)
def test_numbers_that_are_missing_are_told(
    numbers: tuple[int, ...], words: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The clip was a frame shorter, and jumped there."""
    for number in numbers:
        write_splats(tmp_path / f"f{number:04d}.ply", random_splats(20))
    open_scene(str(tmp_path))
    told = [f"{tmp_path}: {words}; the clip goes on without, and what follows comes earlier"] if words else []
    assert [record.getMessage() for record in caplog.records] == told


def test_names_that_differ_in_more_than_a_number_tell_of_no_gap(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for name in ("a1.ply", "b2.ply", "b4.ply", "c1.2.ply"):
        write_splats(tmp_path / name, random_splats(20))
    open_scene(str(tmp_path))
    assert not caplog.records


def test_frames_beyond_the_end_play_again(tmp_path: Path) -> None:
    save(tmp_path, [moved(random_splats(), i) for i in range(3)])
    scene = open_scene(f"{tmp_path}:frames=5")
    np.testing.assert_array_equal(scene.frame(4).means, scene.frame(1).means)
    assert len(open_scene(f"{tmp_path}:frames=2")) == 2
    for index in (-1, 5):
        with pytest.raises(IndexError):
            scene.frame(index)


def shuffled(splats: Splats, seed: int) -> Splats:
    return splats.take(np.random.default_rng(seed).permutation(len(splats)))


REST = random_splats(80)
SEQUENCES: dict[str, tuple[Callable[[int], Splats], bool]] = {
    "deformed (4DGS, TrackerSplat)": (lambda i: moved(REST, 0.1 * i), True),
    "with splats added (HiCoM)": (lambda i: moved(REST, 0.0, 60 + 5 * i), True),
    "still": (lambda i: REST, True),
    "row order new every frame": (lambda i: shuffled(moved(REST, 0.1 * i), i), False),
    "count and order new": (lambda i: shuffled(REST, i).take(slice(0, 70 - i)), False),
    "nothing in common": (lambda i: random_splats(80, seed=i), False),
}


@pytest.mark.parametrize("kind", SEQUENCES)
def test_row_identities_are_found_out(kind: str, tmp_path: Path) -> None:
    make, persists = SEQUENCES[kind]
    save(tmp_path, [make(i) for i in range(3)], "time_{:05d}.ply")
    scene = open_scene(str(tmp_path))
    ids = scene.ids(2)
    assert (ids is not None) == persists
    if ids is not None:
        np.testing.assert_array_equal(ids, np.arange(len(scene.frame(2))))
    assert open_scene(f"{tmp_path}:rows=mixed").ids(1) is None
    assert open_scene(f"{tmp_path}:rows=keep").ids(1) is not None


def test_equal_attributes_of_all_splats_do_not_make_identities(tmp_path: Path) -> None:
    """A converted mesh: every splat has the same size and opacity, and the rows of every frame are sorted anew."""
    arrays = {name: array.copy() for name, array in REST.arrays()}
    for name in ("log_scales", "logit_opacities", "sh0"):
        arrays[name][:] = 1.0
    save(tmp_path, [shuffled(moved(Splats(**arrays), 0.1 * i), i) for i in range(3)])
    assert open_scene(str(tmp_path)).ids(0) is None


def test_training_folders(tmp_path: Path) -> None:
    """The layout of 3DGStream, HiCoM and TrackerSplat; the last iteration counts."""
    for frame in (1, 2, 10):
        for iteration in (7, 30, 150):
            path = f"frame{frame}/point_cloud/iteration_{iteration}/point_cloud.ply"
            save(tmp_path, [moved(REST, frame + iteration / 1000)], path)
    scene = open_scene(str(tmp_path))
    shifts = [float(scene.frame(i).means[0, 0] - REST.means[0, 0]) for i in range(3)]
    np.testing.assert_allclose(shifts, [1.15, 2.15, 10.15], atol=1e-5)
    assert len(open_scene(str(tmp_path / "frame1"))) == 60


def test_unbundled_sog_in_numbered_folders(tmp_path: Path) -> None:
    for i in range(2):
        folder = tmp_path / f"f{i}"
        folder.mkdir()
        for name, content in zip_files(sog_bytes(moved(REST, i))).items():
            (folder / name).write_bytes(content)
    scene = open_scene(str(tmp_path))
    assert len(scene) == 2
    assert scene.frame(1).means[:, 0].mean() - scene.frame(0).means[:, 0].mean() == pytest.approx(1, abs=0.01)
    assert open_scene(str(tmp_path / "f0" / "meta.json")).name == "f0"


def test_folders_that_are_no_sequence(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="holds no frames; supported are"):
        open_scene(str(tmp_path))
    (tmp_path / "params.npz").write_bytes(b"")
    with pytest.raises(SceneError, match=r"holds no frames, but a clip in one file; give .*params\.npz$"):
        open_scene(str(tmp_path))
    write_splats(tmp_path / "a.ply", REST)
    assert len(open_scene(str(tmp_path))) == 60
    write_splats(tmp_path / "b.ply", REST)
    with pytest.raises(SceneError, match=r"a\.ply has no frame number"):
        open_scene(str(tmp_path))
    write_splats(tmp_path / "c.spz", REST)
    with pytest.raises(SceneError, match=r"mixes \.ply and \.spz"):
        open_scene(str(tmp_path))


@pytest.mark.parametrize(
    "name", ["clip.{:04d}.ply", "clip.{}.compressed.ply", "a.b.{}.splat", "{}.x.PLY", "v2.take3.{}.spz"]
)
def test_a_number_may_stand_between_dots(name: str, tmp_path: Path) -> None:
    save(tmp_path, [moved(random_splats(), i) for i in range(11)], name)
    scene = open_scene(str(tmp_path))
    shifts = [float(scene.frame(i).means[:, 0].mean() - scene.frame(0).means[:, 0].mean()) for i in (1, 2, 10)]
    np.testing.assert_allclose(shifts, [1, 2, 10], atol=0.05)


@pytest.mark.parametrize("name", ["one.ply", "one.compressed.ply", "one.v.ply"])
def test_a_file_without_a_number_is_named(name: str, tmp_path: Path) -> None:
    save(tmp_path, [REST, REST])
    write_splats(tmp_path / name, REST)
    with pytest.raises(SceneError, match=f"{re.escape(name)} has no frame number"):
        open_scene(str(tmp_path))


def test_a_suffix_has_no_frame_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a format whose suffix has a digit, too."""
    monkeypatch.setattr(folders, "_ENDINGS", [".3d.ply", ".ply"])
    save(tmp_path, [REST, REST], "{}.3d.ply")
    (tmp_path / "0.3d.ply").rename(tmp_path / "zero.3d.ply")
    with pytest.raises(SceneError, match=r"zero\.3d\.ply has no frame number"):
        open_scene(str(tmp_path))


def test_a_damaged_or_different_later_frame_is_named(tmp_path: Path) -> None:
    save(tmp_path, [random_splats(40, 1), random_splats(40, 1), random_splats(40, 2), random_splats(40, 1)])
    scene = open_scene(f"{tmp_path}:rows=mixed")
    with pytest.raises(SceneError, match=r"frame_2\.ply: has SH degree 2, frame_0\.ply has 1"):
        scene.frame(2)
    (tmp_path / "frame_1.ply").write_bytes(b"ply\n")
    with pytest.raises(SceneError, match=r"frame_1\.ply"):
        scene.frame(1)


def test_scenes_travel_to_workers(tmp_path: Path) -> None:
    save(tmp_path, [moved(REST, i) for i in range(2)])
    scene = open_scene(str(tmp_path))
    copy = pickle.loads(pickle.dumps(scene))
    assert len(pickle.dumps(scene)) < 2_000
    np.testing.assert_array_equal(copy.frame(1).means, scene.frame(1).means)


@pytest.mark.parametrize(("name", "frames"), [("monkey", 50), ("wave", 200), ("playbot", 60), ("guitar", 60)])
def test_shared_scenes_open(name: str, frames: int) -> None:
    scene = open_scene(str(shared_scene(name)))
    assert (scene.name, len(scene), scene.up) == (name, frames, (0, -1, 0))
    assert 0.1 < scene.focus.radius < 4


def test_rows_of_monkey_do_not_persist() -> None:
    """The writer sorts each frame anew, so that neighbouring positions are in distant rows."""
    scene = open_scene(str(shared_scene("monkey")))
    assert scene.ids(0) is None
    a, b = scene.frame(0), scene.frame(1)
    assert np.median(np.linalg.norm(a.means - b.means, axis=1)) > 0.05
