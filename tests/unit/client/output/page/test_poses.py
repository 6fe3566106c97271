"""Who has hold of the camera."""

from __future__ import annotations

from cags_client.output.page.poses import REMEMBERED_POSES, LivePoses
from cags_common.geometry import Pose
from support.live_page import StillWalk


def test_the_walk_leads_until_somebody_takes_hold_and_after_they_let_go() -> None:
    poses = LivePoses(StillWalk())
    walk = StillWalk().pose_at(0)
    assert poses.pose_at(5) == walk
    poses.hold(Pose.identity(), 1)
    assert poses.held
    assert poses.pose_at(5) == Pose.identity()
    poses.release()
    assert not poses.held
    assert poses.pose_at(5) == walk


def test_a_picture_tells_which_pose_it_shows_for_a_while() -> None:
    poses = LivePoses(StillWalk())
    for number in range(REMEMBERED_POSES + 10):
        poses.hold(Pose((float(number), 0, 0), (1, 0, 0, 0)), number)
    assert poses.time_of(Pose((20.0, 0, 0), (1, 0, 0, 0))) == 20
    assert poses.time_of(Pose((3.0, 0, 0), (1, 0, 0, 0))) is None
    poses.hold(Pose((20.0, 0, 0), (1, 0, 0, 0)), 9999)
    assert poses.time_of(Pose((20.0, 0, 0), (1, 0, 0, 0))) == 9999
