"""Poses and cameras keep the conventions."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_common import so3
from cags_common.geometry import Camera, Intrinsics, Pose, angle_between, axis_bounds


def test_looking_at_puts_the_target_on_the_optical_axis():
    pose = Pose.looking_at((1.0, 2.0, 3.0), (4.0, 2.5, -1.0))
    rotation, translation = Camera(Intrinsics.of_fov(4, 3, 1.0, 1.0), pose).world_to_camera
    target = rotation @ np.array([4.0, 2.5, -1.0]) + translation
    assert np.allclose(target[:2], 0, atol=1e-12)
    assert target[2] == pytest.approx(math.dist((1, 2, 3), (4, 2.5, -1)))


def test_up_in_the_world_is_up_in_the_picture():
    pose = Pose.looking_at((0.0, 0.0, 0.0), (0.0, 0.0, 5.0), up=(0.0, 1.0, 0.0))
    rotation, translation = Camera(Intrinsics.of_fov(4, 3, 1.0, 1.0), pose).world_to_camera
    above = rotation @ np.array([0.0, 1.0, 5.0]) + translation
    assert above[1] < 0, "camera +Y is down"


def test_looking_straight_along_up_still_gives_a_rotation():
    matrix = Pose.looking_at((0.0, 0.0, 0.0), (0.0, 3.0, 0.0)).rotation_matrix
    assert np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(matrix) == pytest.approx(1.0)


def test_fov_and_focal_length_are_inverse():
    intrinsics = Intrinsics.of_fov(1600, 1200, 1.48, 1.20)
    assert intrinsics.fov_rad == pytest.approx((1.48, 1.20))
    assert intrinsics.resized(400, 300).fov_rad == pytest.approx((1.48, 1.20))


@pytest.mark.parametrize("fov", [0.0, -1.0, math.pi, math.nan])
def test_impossible_fields_of_view_are_refused(fov):
    with pytest.raises(ValueError, match="fov_x_rad"):
        Intrinsics.of_fov(4, 3, fov, 1.0)


@pytest.mark.parametrize("rotation", [(0.0, 0.0, 0.0, 0.0), (math.nan, 0.0, 0.0, 1.0), (math.inf, 0.0, 0.0, 0.0)])
def test_quaternions_without_direction_are_refused(rotation):
    with pytest.raises(ValueError, match="no direction"):
        Pose((0.0, 0.0, 0.0), rotation)


def test_non_finite_positions_are_refused():
    with pytest.raises(ValueError, match="not finite"):
        Pose((0.0, math.nan, 0.0), (1.0, 0.0, 0.0, 0.0))


@pytest.mark.parametrize("count", [1, 63, 64, 65, 1000])
def test_axis_bounds_are_those_of_every_row(count):
    points = np.random.default_rng(count).normal(size=(count, 3)).astype(np.float32)
    low, high = axis_bounds(points)
    assert np.array_equal(low, points.min(axis=0)) and np.array_equal(high, points.max(axis=0))
    points[count // 2, 1] = np.nan
    assert [np.isnan(corner).tolist() for corner in axis_bounds(points)] == [[False, True, False]] * 2


numbers = st.floats(-10, 10)
turns = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: sum(c * c for c in q) > 0.1)
poses = st.builds(Pose, st.tuples(numbers, numbers, numbers), turns)


@given(poses, poses, st.floats(0, 1))
def test_between_two_poses_lies_what_the_arrays_say(a, b, fraction):
    middle = a.towards(b, fraction)
    assert np.allclose(middle.position, np.array(a.position) * (1 - fraction) + np.array(b.position) * fraction)
    angle = angle_between(a.rotation, b.rotation)
    assert angle_between(a.rotation, middle.rotation) == pytest.approx(fraction * angle, abs=1e-6)
    if angle < math.pi - 1e-3:  # of half a turn either arc is the shorter
        expected = so3.slerp(np.array([a.rotation]), np.array([b.rotation]), np.array([fraction]))[0]
        assert abs(float(expected @ np.array(middle.rotation))) == pytest.approx(1.0, abs=1e-9)
