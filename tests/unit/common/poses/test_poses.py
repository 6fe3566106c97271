import math
from pathlib import Path

import numpy as np
import pytest

from cags_common.errors import TraceError
from cags_common.geometry import Pose, angle_between
from cags_common.poses import KINDS, Focus, PoseTrace, open_poses, place, read_poses, synthetic_walk, write_poses
from cags_common.poses.place import gravity_up

HEADER = "time_s,px,py,pz,qw,qx,qy,qz\n"
FOCUS = Focus((1.0, 2.0, 3.0), 0.8, (0.0, -1.0, 0.0))
WALKS = Path(__file__).parents[4].parent / "shared" / "poses" / "eyenavgs_nthu"


def trace(*rows: tuple[float, Pose]) -> PoseTrace:
    return PoseTrace(
        np.array([round(t * 1e6) for t, _ in rows], np.int64),
        np.array([p.position for _, p in rows]),
        np.array([p.rotation for _, p in rows]),
    )


def angles_off(walk: PoseTrace, focus: Focus) -> np.ndarray:
    offset = np.asarray(focus.centre) - walk.positions
    offset /= np.linalg.norm(offset, axis=1, keepdims=True)
    return np.degrees(np.arccos(np.clip((offset * walk.matrices[:, :, 2]).sum(axis=1), -1, 1)))


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "walk.csv"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "is empty"),
        ("a,b\n", "line 1 is 'a,b'"),
        (HEADER, "no samples"),
        (HEADER + "0,0,0,0,1,0,0\n", "line 2: has 7 columns"),
        (HEADER + "0,0,0,zero,1,0,0,0\n", "line 2: could not convert"),
        (HEADER + "0,0,0,nan,1,0,0,0\n", "line 2: holds a number that is not finite"),
        (HEADER + "0,0,0,0,0,0,0,0\n", "quaternion of length 0.0000"),
        (HEADER + "0,0,0,0,1,0,0,0\n0,0,0,0,1,0,0,0\n", "line 3: time 0 s is not after"),
        (HEADER + "0,0,0,0,1,0,0,0\n1e-9,0,0,0,1,0,0,0\n", "less than a microsecond"),
        (HEADER + "0,0,0,0,1,0,0,0\n1,0,-1e300,0,1,0,0,0\n", r"line 3: position -1e\+300 is beyond 1e\+06"),
        (HEADER + "0,0,0,0,1,0,0,0\n1e20,0,0,0,1,0,0,0\n", "lasts 1e.20 s, more than 1e.08 s"),
    ],
)
def test_a_malformed_file_is_named_with_its_line(tmp_path: Path, text: str, complaint: str) -> None:
    with pytest.raises(TraceError, match=complaint) as caught:
        read_poses(write(tmp_path, text))
    assert "walk.csv" in str(caught.value)


def test_a_missing_file_and_a_binary_one_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(TraceError, match="No such file"):
        read_poses(tmp_path / "none.csv")
    (tmp_path / "b.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(TraceError, match="not a CSV"):
        read_poses(tmp_path / "b.csv")


def test_openxr_axes_become_opencv_ones(tmp_path: Path) -> None:
    path = write(tmp_path, HEADER + "5.0,0,0,0,1,0,0,0\n")
    looking_back_upright = read_poses(path).matrices[0]
    np.testing.assert_allclose(looking_back_upright, np.diag([1.0, -1.0, -1.0]), atol=1e-12)
    np.testing.assert_allclose(read_poses(path, axes="opencv").matrices[0], np.eye(3), atol=1e-12)
    assert read_poses(path).times_us.tolist() == [0]


def test_a_written_trace_reads_back(tmp_path: Path) -> None:
    walk = synthetic_walk("walking", FOCUS, duration_s=1.0)
    write_poses(walk, tmp_path / "w.csv")
    again = read_poses(tmp_path / "w.csv")
    np.testing.assert_array_equal(again.times_us, walk.times_us)
    np.testing.assert_allclose(again.positions, walk.positions, atol=1e-6)
    np.testing.assert_allclose(again.matrices, walk.matrices, atol=1e-7)


def test_half_way_is_half_the_angle_and_half_the_path() -> None:
    walk = trace((0, Pose((0, 0, 0), (1, 0, 0, 0))), (1, Pose((2, 0, 0), (math.cos(0.6), 0, math.sin(0.6), 0))))
    middle = walk.pose_at(500_000)
    assert middle.position == pytest.approx((1, 0, 0))
    assert angle_between((1, 0, 0, 0), middle.rotation) == pytest.approx(0.6)


def test_opposite_signs_of_a_quaternion_do_not_turn_the_head() -> None:
    walk = trace((0, Pose.identity()), (1, Pose.identity()))
    flipped = PoseTrace(walk.times_us, walk.positions, walk.rotations * np.array([[1.0], [-1.0]]))
    assert angle_between((1, 0, 0, 0), flipped.pose_at(500_000).rotation) == pytest.approx(0.0, abs=1e-9)


def test_past_its_end_a_walk_goes_back_the_way_it_came() -> None:
    walk = synthetic_walk("looking", FOCUS, duration_s=2.0)
    for ahead in (1, 250_000, walk.duration_us):
        there, back = walk.pose_at(walk.duration_us - ahead), walk.pose_at(walk.duration_us + ahead)
        assert back.position == pytest.approx(there.position, abs=1e-9)
        assert angle_between(back.rotation, there.rotation) < 1e-6


def test_a_single_sample_holds_for_ever() -> None:
    assert trace((0, Pose((1, 2, 3), (1, 0, 0, 0)))).pose_at(10**12).position == (1, 2, 3)


def test_gravity_is_found_though_the_walker_looks_down() -> None:
    down = [Pose.looking_at((0, 0, 0), (math.cos(a), -0.7, math.sin(a))) for a in np.linspace(0, 2.0, 20)]
    up = gravity_up(trace(*((float(i), pose) for i, pose in enumerate(down))))
    np.testing.assert_allclose(up, (0, 1, 0), atol=0.02)


@pytest.mark.parametrize("up", [(0, 1, 0), (0, -1, 0), (0, 0, 1), (1, 0, 0), (0.3, 0.8, -0.2)])
def test_a_placed_walk_looks_at_the_focus_and_keeps_its_angles(up: tuple[float, float, float]) -> None:
    walk = synthetic_walk("walking", Focus((0, 0, 0), 3.0), duration_s=4.0)
    focus = Focus((7, -2, 1), 0.5, up)
    placed = place(walk, focus)
    assert np.percentile(angles_off(placed, focus), 90) < 30
    distances = np.linalg.norm(placed.positions - np.asarray(focus.centre), axis=1) / focus.radius
    assert distances.min() > 1.0
    assert np.median(distances) == pytest.approx(2.2, rel=0.02)
    for i, j in ((0, 50), (100, 280)):
        before, after = (
            angle_between(w.pose_at(w.times_us[i]).rotation, w.pose_at(w.times_us[j]).rotation) for w in (walk, placed)
        )
        assert after == pytest.approx(before, abs=1e-6)
    assert gravity_up(placed) @ np.asarray(up) / np.linalg.norm(up) > 0.97


@pytest.mark.skipif(not WALKS.is_dir(), reason="recorded walks (../shared/poses) are not here")
@pytest.mark.parametrize("name", ["room_user01.csv", "playroom_user05.csv", "truck_user09.csv"])
def test_recorded_walks_see_the_scene_for_their_first_seconds(name: str) -> None:
    placed = open_poses(str(WALKS / name), FOCUS, window_us=2_000_000).window(0, 2_000_000)
    assert np.median(angles_off(placed, FOCUS)) < 30


@pytest.mark.parametrize("kind", KINDS)
def test_synthetic_walks_are_deterministic_and_differ_by_seed(kind: str) -> None:
    one, same, other = (synthetic_walk(kind, FOCUS, seed=s, duration_s=5.0) for s in (1, 1, 2))
    np.testing.assert_array_equal(one.positions, same.positions)
    np.testing.assert_array_equal(one.rotations, same.rotations)
    assert kind == "still" or not np.array_equal(one.rotations, other.rotations)
    assert np.median(angles_off(one, FOCUS)) < 35


def test_still_is_still_and_turning_is_fast() -> None:
    def speed_deg_s(kind: str) -> float:
        m = synthetic_walk(kind, FOCUS, duration_s=6.0).matrices
        cosine = (np.einsum("nij,nij->n", m[1:], m[:-1]) - 1) / 2
        return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() * 72)

    assert speed_deg_s("still") < 1e-3
    assert speed_deg_s("turning") > 150


@pytest.mark.parametrize(
    "spec", ["synthetic", "synthetic:dancing", "synthetic:still:speed=2", "synthetic:still:seed=-1", "nowhere.csv"]
)
def test_unknown_specs_are_named(spec: str) -> None:
    with pytest.raises(TraceError) as caught:
        open_poses(spec, FOCUS)
    assert spec.split(":")[1 if spec.startswith("synthetic:d") else 0] in str(caught.value)


@pytest.mark.parametrize(("radius", "up"), [(0.0, (0, 1, 0)), (math.nan, (0, 1, 0)), (1.0, (0, 0, 0))])
def test_a_focus_without_size_or_direction_is_refused(radius: float, up: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match=r"focus|up"):
        Focus((0, 0, 0), radius, up)
