"""The room around a walk: it holds the walk, and rays end at its walls."""

from __future__ import annotations

import numpy as np

from cags_common.poses.room import CLEARANCE_M, HALF_SIZE_M, Room


def test_a_short_walk_has_the_least_room_and_a_long_one_clearance() -> None:
    short = Room.around(np.zeros((3, 3)))
    assert (short.low == -HALF_SIZE_M).all() and (short.high == HALF_SIZE_M).all()
    long = Room.around(np.array([[0.0, 0, 0], [20.0, 0, 0]]))
    assert long.low[0] == -CLEARANCE_M and long.high[0] == 20 + CLEARANCE_M


def test_rays_end_at_the_nearest_wall_in_camera_axes() -> None:
    room = Room(np.full(3, -1.0), np.full(3, 3.0))
    quarter = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # camera +Z is world +X
    rays = np.array([[0.0, 0.0, 1.0], [0.5, 0.0, 1.0], [0.0, -4.0, 1.0]])
    assert np.allclose(room.points(np.zeros(3), np.eye(3), rays)[0], [0, 0, 3])
    ends = room.points(np.array([1.0, 0, 0]), quarter, rays)
    world = ends @ quarter.T + [1.0, 0, 0]
    assert np.allclose(world[0], [3, 0, 0])
    assert (np.isclose(world, room.low) | np.isclose(world, room.high)).any(axis=1).all()
    assert ((world > room.low - 1e-9) & (world < room.high + 1e-9)).all()
