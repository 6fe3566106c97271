import math

import numpy as np
import pytest

from cags_common.geometry import Intrinsics, Pose, quaternion_of_rotation_vector
from cags_common.poses.room import Room
from cags_server.fov import MAX_REFERENCE_FOV_RAD, widened
from cags_server.fov.truth import (
    area_ratio,
    covered_share,
    exact_margins,
    fast_margins,
    in_reference,
    margins_for,
    view_rays,
)

CLIENT = Intrinsics.of_fov(80, 60, 1.2, 0.95)


def turned(pitch: float = 0.0, yaw: float = 0.0, roll: float = 0.0) -> Pose:
    return Pose((0.0, 0.0, 0.0), quaternion_of_rotation_vector((pitch, yaw, roll)))


def test_a_perfect_prediction_needs_no_margin() -> None:
    pose = turned(0.2, 0.4, -0.1)
    assert fast_margins(CLIENT, pose, pose) == pytest.approx((0, 0), abs=1e-12)
    assert exact_margins(np.full((60, 80), 3.0), CLIENT, pose, pose) == (0, 0)


def test_a_yaw_widens_by_at_least_its_angle() -> None:
    s_x, s_y = fast_margins(CLIENT, turned(yaw=0.1), turned())
    assert s_x >= 0.1 / 0.6 - 1e-9
    assert s_y >= 0


@pytest.mark.parametrize("error", [turned(0.05, -0.1, 0.02), turned(roll=0.3), Pose((0.2, -0.1, 0.3), (1, 0, 0, 0))])
def test_exact_margins_cover_every_pixel_and_no_less_would(error: Pose) -> None:
    rng = np.random.default_rng(0)
    depth = 2.0 + rng.random((60, 80))
    margins = exact_margins(depth, CLIENT, error, Pose.identity())
    u, v = np.meshgrid((np.arange(80) + 0.5 - 40) / CLIENT.fx_px, (np.arange(60) + 0.5 - 30) / CLIENT.fy_px)
    points = in_reference(np.stack([u * depth, v * depth, depth], -1).reshape(-1, 3), error, Pose.identity())
    assert covered_share(points, widened(CLIENT, margins, 400, 300)) == 1.0
    for axis in (0, 1):
        if margins[axis] > 0.02:
            less = (margins[0] - 0.02 * (axis == 0), margins[1] - 0.02 * (axis == 1))
            assert covered_share(points, widened(CLIENT, less, 400, 300)) < 1.0


def test_the_fast_margins_are_near_the_exact_ones_when_the_depth_is_right() -> None:
    error = Pose((0.05, 0.02, 0.0), turned(0.03, 0.08, 0.02).rotation)
    exact = exact_margins(np.full((60, 80), 10.0), CLIENT, error, Pose.identity())
    assert fast_margins(CLIENT, error, Pose.identity()) == pytest.approx(exact, abs=0.04)


def test_void_pixels_ask_for_nothing() -> None:
    assert exact_margins(np.full((60, 80), np.inf), CLIENT, turned(yaw=0.5), turned()) == (0, 0)


@pytest.mark.parametrize("error", [turned(yaw=math.pi), turned(pitch=1.5), Pose((0, 0, 50), (1, 0, 0, 0))])
def test_what_lies_behind_asks_for_the_widest_view_and_never_for_more(error: Pose) -> None:
    margins = fast_margins(CLIENT, error, Pose.identity(), depth_m=3.0)
    assert all(0 <= s < 10 for s in margins)
    fov = widened(CLIENT, margins, 400, 300).fov_rad
    assert max(fov) <= MAX_REFERENCE_FOV_RAD + 1e-9


def test_rays_reach_the_borders_of_the_picture() -> None:
    rays = view_rays(CLIENT, 5, 5)
    assert rays[:, 0].max() == pytest.approx(math.tan(0.6))
    assert margins_for(rays, CLIENT) == pytest.approx((0, 0), abs=1e-9)


def test_area_is_that_of_the_plane_at_unit_distance() -> None:
    wide = widened(CLIENT, (0.1, 0.2), 400, 300)
    expected = math.tan(0.66) * math.tan(0.57) / (math.tan(0.6) * math.tan(0.475))
    assert area_ratio(CLIENT, wide) == pytest.approx(expected)


def test_points_of_a_room_lie_on_its_walls() -> None:
    room = Room.around(np.array([[0.0, 1.6, 0.0], [1.0, 1.6, 0.5]]))
    pose = turned(0.3, 2.0)
    rays = view_rays(CLIENT, 7, 7)
    points = room.points(np.zeros(3), pose.rotation_matrix, rays)
    world = points @ pose.rotation_matrix.T
    on_wall = np.isclose(world, room.low) | np.isclose(world, room.high)
    assert on_wall.any(axis=1).all()
    assert (world >= room.low - 1e-9).all()
    assert (world <= room.high + 1e-9).all()
