"""How much of a reference is used from how far away."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_common.correction.reach import apart, valid_share
from cags_common.geometry import Pose, Vec3, quaternion_of_rotation_vector

CENTRE = (0.0, 0.0, 4.0)
lengths = st.floats(-3, 3)
poses = st.builds(
    lambda position, turn: Pose(position, quaternion_of_rotation_vector(turn)),
    st.tuples(lengths, lengths, lengths),
    st.tuples(lengths, lengths, lengths),
)


def test_a_turn_counts_as_its_angle_and_a_step_as_that_which_the_scene_turns_by() -> None:
    here = Pose.identity()
    there = Pose((0.4, 0.0, 0.0), quaternion_of_rotation_vector((0.0, 0.2, 0.0)))
    assert apart(there, here, CENTRE, 1.0) == pytest.approx(0.2 + 0.1)
    assert apart(there, here, (0.0, 0.0, 0.1), 2.0) == pytest.approx(0.2 + 0.2), "within the scene its radius counts"


@given(poses, poses, st.tuples(lengths, lengths, lengths), st.floats(1e-3, 10))
def test_views_are_apart_unless_they_are_the_same(a: Pose, b: Pose, centre: Vec3, radius: float) -> None:
    assert apart(a, a, centre, radius) < 1e-6
    distance = apart(a, b, centre, radius)
    assert math.isfinite(distance)
    assert distance >= 0


@given(st.floats(0, 1e9), st.floats(0, 1e9), st.floats(0, 10), st.floats(0, 10))
def test_less_is_used_from_farther_away_and_nothing_is_lost_within_reach(
    a: float, b: float, c: float, d: float
) -> None:
    near, far = sorted((a, b))
    short, long = sorted((c, d))
    assert valid_share(short, long) == 1
    assert 0 <= valid_share(far, short) <= valid_share(near, short) <= valid_share(near, long) <= 1
